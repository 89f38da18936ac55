// Numbers with their noun, as people read them.

/** `12,345`. */
export function count(n: number): string {
  return n.toLocaleString("en-US");
}

/** The value with this number of decimals, and no sign before zero. */
export function fixed(value: number, decimals: number): string {
  return (Number(value.toFixed(decimals)) || 0).toFixed(decimals);
}

/** `1 sequence`, `12,345 sequences`. */
export function counted(n: number, noun: string): string {
  return `${count(n)} ${n === 1 ? noun : `${noun}s`}`;
}
