// Unfinished uploads of the platform, and the chosen bags that continue them.

import { call } from "../api.js";
import { toast } from "../notices.js";
import { written } from "../times.js";
import type { Bag } from "./bags.js";
import { all, type UploadItem } from "./file_upload.js";
import { size } from "./speed.js";

export interface Unfinished {
  upload: UploadItem;
  sequenceId: string;
  sequenceName: string;
}

/** The uploads of recordings without a recording, with their sequences; optionally only those of one sequence. */
export async function unfinished(sequenceId: string): Promise<Unfinished[]> {
  const some = await Promise.all(["open", "complete"].map((state) => all<UploadItem>(`/api/v1/uploads?state=${state}`)));
  const begun = some.flat().filter((upload) => upload.purpose === "recording" && upload.target_id);
  const mine = begun.filter((upload) => !sequenceId || upload.target_id === sequenceId);
  const names = new Map<string, string>();
  for (const id of new Set(mine.map((upload) => upload.target_id ?? ""))) names.set(id, await nameOf(id));
  return mine
    .filter((upload) => names.get(upload.target_id ?? ""))
    .map((upload) => ({ upload, sequenceId: upload.target_id ?? "", sequenceName: names.get(upload.target_id ?? "") ?? "" }));
}

/** The unfinished upload of this bag: a file of the same name and size. */
export function begunOf(bag: Bag, begun: readonly Unfinished[]): Unfinished | undefined {
  return begun.find(({ upload }) => bag.files.some((file) => file.name === upload.filename && file.size === upload.length_bytes));
}

/** Shows them in `place`, each with a button to discard it; then `again` is called. */
export function showUnfinished(place: HTMLElement, begun: readonly Unfinished[], again: () => void): void {
  place.hidden = !begun.length;
  const title = Object.assign(document.createElement("h3"), { textContent: "Unfinished" });
  const advice = Object.assign(document.createElement("p"), {
    className: "hint",
    textContent: "Select or drop the same files again: the upload resumes where it stopped.",
  });
  const list = document.createElement("ul");
  list.append(...begun.map((one) => itemOf(one, again)));
  place.replaceChildren(title, advice, list);
}

function itemOf({ upload, sequenceName }: Unfinished, again: () => void): HTMLLIElement {
  const item = document.createElement("li");
  const words = document.createElement("span");
  const part = upload.length_bytes ? Math.floor((100 * upload.offset_bytes) / upload.length_bytes) : 100;
  words.append(Object.assign(document.createElement("strong"), { textContent: upload.filename }));
  words.append(` for ${sequenceName}: ${part} % of ${size(upload.length_bytes)} uploaded, kept until ${written(new Date(upload.expires_at))}`);
  const give = Object.assign(document.createElement("button"), { type: "button", className: "small quiet", textContent: "Discard" });
  give.setAttribute("aria-label", `Discard ${upload.filename}`);
  give.addEventListener("click", () => void giveUp(upload).then(again));
  item.append(words, give);
  return item;
}

async function giveUp(upload: UploadItem): Promise<void> {
  try {
    await call("DELETE", `/api/v1/uploads/${upload.id}`, undefined, { "Tus-Resumable": "1.0.0" });
    toast(`${upload.filename} was discarded.`);
  } catch (error) {
    toast(String(error));
  }
}

async function nameOf(sequenceId: string): Promise<string> {
  try {
    return (await call<{ name: string }>("GET", `/api/v1/sequences/${sequenceId}`)).name;
  } catch {
    return ""; // deleted meanwhile
  }
}
