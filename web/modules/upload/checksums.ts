// A cache of sha256 sums, so that a reloaded page need not hash for minutes.
//
// The key is name, size and modification time. If a cached sum is wrong, the platform's own hash differs and it refuses
// the file; then the sum is dropped.

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
    // storage is full or denied; the sum is computed again next time
  }
}

const TABLE = new TextEncoder();

/** The checksum of a bag of several files: over the lines `sha256sum` prints for them in order of name. */
export function linesOf(files: readonly { name: string; sum: string }[]): Blob {
  const ordered = [...files].sort((a, b) => (a.name < b.name ? -1 : 1));
  return new Blob([TABLE.encode(ordered.map(({ name, sum }) => `${sum}  ${name}\n`).join(""))]);
}
