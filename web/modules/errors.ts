// What is said of something that was thrown.

/** Its message, or itself in words where it is no error. */
export function messageOf(thrown: unknown): string {
  return thrown instanceof Error ? thrown.message : String(thrown);
}
