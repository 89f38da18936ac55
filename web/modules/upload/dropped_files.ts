// Dropped or chosen files, with those in folders, each with its path.

import type { Found } from "./bags.js";

const DEEPEST = 8;
const MOST = 20_000;

/** The files of an `<input type="file">`, with their paths below a chosen folder. */
export function chosen(files: FileList): Found[] {
  return [...files].map((file) => ({ file, path: file.webkitRelativePath || file.name }));
}

/** The dropped files, with folders opened. The entries must be taken before the event has passed. */
export async function dropped(data: DataTransfer): Promise<Found[]> {
  const taken = [...data.items].filter((item) => item.kind === "file").map((item) => ({
    entry: item.webkitGetAsEntry(),
    file: item.getAsFile(),
  }));
  const found: Found[] = [];
  for (const { entry, file } of taken) {
    if (entry) await walk(entry, "", found, 0);
    else if (file) found.push({ file, path: file.name });
  }
  return found;
}

async function walk(entry: FileSystemEntry, above: string, found: Found[], depth: number): Promise<void> {
  if (depth > DEEPEST || found.length >= MOST) return;
  const path = above ? `${above}/${entry.name}` : entry.name;
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
    found.push({ file, path });
    return;
  }
  for (const inside of await entriesOf(entry as FileSystemDirectoryEntry)) await walk(inside, path, found, depth + 1);
}

/** All entries of a folder, which come in pieces of a hundred. */
async function entriesOf(folder: FileSystemDirectoryEntry): Promise<FileSystemEntry[]> {
  const reader = folder.createReader();
  const all: FileSystemEntry[] = [];
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (!some.length) return all;
    all.push(...some);
  }
}
