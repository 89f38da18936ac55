// The sha256 sums of files that were counted before, so that a page that was loaded again need not count for minutes.
//
// A sum is known by name, size and time of change. Should it be wrong all the same, the platform refuses the file, since
// it counts for itself; then the sum is forgotten.

const KEY = "stone-sha256";
const MOST = 500;

export function knownSum(file: File): string | undefined {
  return kept()[nameOf(file)];
}

export function keepSum(file: File, sum: string): void {
  const sums = Object.entries({ ...kept(), [nameOf(file)]: sum });
  store(Object.fromEntries(sums.slice(-MOST)));
}

export function forgetSum(file: File): void {
  const sums = kept();
  delete sums[nameOf(file)];
  store(sums);
}

function nameOf(file: File): string {
  return `${file.name}|${file.size}|${file.lastModified}`;
}

function kept(): Record<string, string> {
  try {
    return JSON.parse(localStorage.getItem(KEY) ?? "{}") as Record<string, string>;
  } catch {
    return {};
  }
}

function store(sums: Record<string, string>): void {
  try {
    localStorage.setItem(KEY, JSON.stringify(sums));
  } catch {
    // no room, or none allowed: then it is counted again
  }
}

const TABLE = new TextEncoder();

/** The checksum of a bag of several files: over the lines `sha256sum` prints for them in order of name. */
export function linesOf(files: readonly { name: string; sum: string }[]): Blob {
  const ordered = [...files].sort((a, b) => (a.name < b.name ? -1 : 1));
  return new Blob([TABLE.encode(ordered.map(({ name, sum }) => `${sum}  ${name}\n`).join(""))]);
}
