// The part of each sequence, as values: moves create new arrangements, so that each can be undone.

/** A part of the splits; "" is none. */
export type Part = "train" | "val" | "test" | "";
export const PARTS: readonly Part[] = ["train", "val", "test", ""];

/** A labelled sequence as its card describes it; `voxels` are T, P and N, null if unknown. */
export interface Entry {
  id: string;
  name: string;
  environment: string;
  half: string;
  duration_s: number;
  frames: number;
  voxels: readonly [number, number, number] | null;
}

/** The part of each sequence, by id. */
export type Arrangement = ReadonlyMap<string, Part>;

export interface Move {
  id: string;
  from: Part;
  to: Part;
}

export interface Totals {
  sequences: number;
  frames: number;
  duration_s: number;
  voxels: [number, number, number];
  words: Set<string>;
}

/** The three lists of ids that the API takes. */
export interface Lists {
  train: string[];
  val: string[];
  test: string[];
}

export function partOf(word: string | undefined): Part {
  return PARTS.find((part) => part === word) ?? "";
}

/** How a part is called in a sentence. */
export function called(part: Part): string {
  return part || "unassigned";
}

export function moved(arrangement: Arrangement, ids: Iterable<string>, part: Part): Arrangement {
  const next = new Map(arrangement);
  for (const id of ids) if (next.has(id)) next.set(id, part);
  return next;
}

/** The arrangement of these lists; sequences in no list are unassigned. */
export function arranged(ids: Iterable<string>, lists: Lists): Arrangement {
  const parts = new Map<string, Part>();
  for (const part of ["train", "val", "test"] as const) for (const id of lists[part]) parts.set(id, part);
  return new Map([...ids].map((id) => [id, parts.get(id) ?? ""]));
}

export function listsOf(arrangement: Arrangement): Lists {
  const of = (part: Part): string[] => [...arrangement].filter(([, at]) => at === part).map(([id]) => id);
  return { train: of("train"), val: of("val"), test: of("test") };
}

export function differences(from: Arrangement, to: Arrangement): Move[] {
  return [...to].flatMap(([id, part]) => {
    const before = from.get(id) ?? "";
    return before === part ? [] : [{ id, from: before, to: part }];
  });
}

export function totalsOf(entries: Iterable<Entry>): Totals {
  const totals: Totals = { sequences: 0, frames: 0, duration_s: 0, voxels: [0, 0, 0], words: new Set() };
  for (const entry of entries) {
    totals.sequences += 1;
    totals.frames += entry.frames;
    totals.duration_s += entry.duration_s;
    totals.words.add(entry.environment).add(entry.half);
    entry.voxels?.forEach((count, place) => (totals.voxels[place as 0 | 1 | 2] += count));
  }
  return totals;
}
