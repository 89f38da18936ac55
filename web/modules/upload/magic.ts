// Detects by its first bytes whether a file is a bag, so that 20 GB of an HTML page are refused before they are sent.
//
// The rules and the words are the platform's own (`stone_recordings/bags/magic.py`). Files that only the platform can
// judge pass: files compressed with zstd, and truncated files.

const FIRST_BYTES = 512;
const SHOWN_BYTES = 16;
const PIECE_BYTES = 2 ** 20;
const MOST_ZEROS_BYTES = 64 * 2 ** 20; // files with more zeros are left to the platform
const MCAP = "\x89MCAP0\r\n";
const ROS1 = "#ROSBAG V2.0\n";
const SQLITE = "SQLite format 3\0";
const ZSTD = "\x28\xb5\x2f\xfd";
const OLD_ROS1 = "a ROS 1 bag of a version before 2.0: where ROS 1 runs, rosbag filter old.bag new.bag True rewrites it";
const KNOWN: readonly (readonly [string, string])[] = [
  ["#ROSBAG V1", OLD_ROS1],
  ["#ROSRECORD V1", OLD_ROS1],
  ["PK\x03\x04", "a zip archive: unpack it first"],
  ["\x1f\x8b", "a gzip archive: unpack it first"],
  ["\x04\x22\x4d\x18", "a file compressed with lz4: unpack it first"],
  ["BZh", "a bzip2 archive: unpack it first"],
  ["\xfd7zXZ", "an xz archive: unpack it first"],
  ["version https://git-lfs", "a Git LFS pointer: fetch the file itself"],
  ["\xd4\xc3\xb2\xa1", "a network capture (pcap)"],
  ["\x0a\x0d\x0d\x0a", "a network capture (pcapng)"],
  ["\x7fELF", "a program"],
];

/** The reason why the platform would refuse the file as BAG-001, or an empty string. A write-ahead log may stand in for
 * a database. */
export async function refusalOf(file: File, hasWal: boolean): Promise<string> {
  const first = await text(file.slice(0, FIRST_BYTES));
  if ([MCAP, ROS1, SQLITE, ZSTD].some((magic) => first.startsWith(magic))) return "";
  if (first ? MCAP.startsWith(first) || ROS1.startsWith(first) : hasWal) return "";
  if (await endsAsMcap(file)) return "";
  const shown = first.slice(0, SHOWN_BYTES);
  const hex = [...shown].map((one) => one.charCodeAt(0).toString(16).padStart(2, "0")).join(" ");
  const quoted = shown ? `first bytes ${hex} "${shown.replaceAll(/[^ -~]/g, ".")}"` : "no bytes at all";
  return `${file.name} is not an MCAP, SQLite or ROS 1 bag (${quoted}); it looks like ${looksLike(first)}`;
}

/** Whether the file ends like an MCAP, ignoring zeros behind it, because a damaged MCAP may lack its beginning. */
async function endsAsMcap(file: File): Promise<boolean> {
  for (let stop = file.size; stop > 0; stop -= PIECE_BYTES) {
    if (file.size - stop >= MOST_ZEROS_BYTES) return true;
    const start = Math.max(0, stop - PIECE_BYTES);
    const rest = (await text(file.slice(start, stop))).replace(/\0+$/, "").length;
    if (rest) return (await text(file.slice(Math.max(0, start + rest - MCAP.length), start + rest))) === MCAP;
  }
  return false;
}

function looksLike(first: string): string {
  if (!first) return "an empty file";
  const known = KNOWN.find(([magic]) => first.startsWith(magic));
  if (known) return known[1];
  if (first.slice(257, 262) === "ustar") return "a tar archive: unpack it first";
  const lowered = first.replace(/^[ \t\n\r\v\f]+/, "").toLowerCase();
  if (lowered.startsWith("<!doctype html") || lowered.includes("<html")) {
    return "an HTML page: the download gave a login or error page instead of the file";
  }
  if (lowered.startsWith("<")) return "XML";
  if (/^[{[]/.test(lowered)) return "JSON";
  return /^[\t\r\n\x20-\xff]*$/.test(first) ? "plain text" : "an unknown format";
}

/** The bytes as characters of the same number. */
async function text(part: Blob): Promise<string> {
  const bytes = new Uint8Array(await part.arrayBuffer());
  const pieces = [];
  for (let at = 0; at < bytes.length; at += 2 ** 14) pieces.push(String.fromCharCode(...bytes.subarray(at, at + 2 ** 14)));
  return pieces.join("");
}
