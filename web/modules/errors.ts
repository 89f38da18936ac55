// The text of a thrown value.

/** Returns its message, or the value as text if it is no error. */
export function messageOf(thrown: unknown): string {
  return thrown instanceof Error ? thrown.message : String(thrown);
}
