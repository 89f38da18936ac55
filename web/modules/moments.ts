// Dates in forms (`parts/moments.html`): chosen by the browser's picker in the time zone beside it, kept as UTC.
//
// An untouched field is sent unchanged, because the picker has whole seconds and the platform microseconds. A spring
// hour that a zone skips becomes the following hour; a repeated autumn hour becomes one of the two.

const SECOND_MS = 1000;
const MINUTE_MS = 60_000;

/** Fill in the fields of every form that has a time zone, and follow the zone that is chosen. */
export function installMoments(root: ParentNode = document): void {
  for (const select of root.querySelectorAll<HTMLSelectElement>("select[data-zone]")) {
    const own = Intl.DateTimeFormat().resolvedOptions().timeZone;
    if (own && ![...select.options].some(({ value }) => value === own)) select.add(new Option(own, own), 0);
    select.value = own || "UTC";
    let shownIn = select.value;
    for (const field of fieldsOf(select)) {
      const iso = field.dataset["iso"];
      field.value = iso ? wallOf(Date.parse(iso), shownIn) : "";
      field.addEventListener("input", () => sayUtc(field));
      sayUtc(field);
    }
    select.addEventListener("change", () => {
      for (const field of fieldsOf(select)) {
        const at = momentIn(field, shownIn);
        field.value = at ? wallOf(Date.parse(at), select.value) : "";
      }
      shownIn = select.value;
    });
  }
}

/** The field's moment as `2026-06-01T00:00:00Z`; null if it is empty. */
export function momentOf(field: HTMLInputElement): string | null {
  return momentIn(field, field.form?.querySelector<HTMLSelectElement>("select[data-zone]")?.value ?? "UTC");
}

/** The instant at which clocks in a zone show `wall` (`2026-06-01T09:00`), in milliseconds. */
export function instantOf(wall: string, zone: string): number {
  const shown_ms = Date.parse(`${wall}Z`);
  const first_ms = shown_ms - offsetOf(shown_ms, zone);
  const second_ms = shown_ms - offsetOf(first_ms, zone);
  return second_ms + offsetOf(second_ms, zone) === shown_ms ? second_ms : Math.max(first_ms, second_ms);
}

/** The wall time of a zone at an instant: `2026-06-01T09:00:00`. */
export function wallOf(at_ms: number, zone: string): string {
  return new Date(at_ms + offsetOf(at_ms, zone)).toISOString().slice(0, -5);
}

function momentIn(field: HTMLInputElement, zone: string): string | null {
  if (!field.value) return null;
  const { iso } = field.dataset;
  const at_ms = instantOf(field.value, zone);
  if (iso && Math.floor(Date.parse(iso) / SECOND_MS) === Math.floor(at_ms / SECOND_MS)) return iso;
  return new Date(at_ms).toISOString().replace(".000Z", "Z");
}

/** How far a zone's clocks are ahead of UTC at an instant. */
function offsetOf(at_ms: number, zone: string): number {
  const parts = new Intl.DateTimeFormat("en-US", {
    timeZone: zone, hourCycle: "h23", year: "numeric", month: "numeric", day: "numeric", hour: "numeric", minute: "numeric", second: "numeric",
  }).formatToParts(at_ms);
  const of = (type: string): number => Number(parts.find((part) => part.type === type)?.value ?? 0);
  const shown_ms = Date.UTC(of("year"), of("month") - 1, of("day"), of("hour"), of("minute"), of("second"));
  return shown_ms - Math.floor(at_ms / SECOND_MS) * SECOND_MS;
}

function fieldsOf(select: HTMLSelectElement): HTMLInputElement[] {
  return [...(select.form?.querySelectorAll<HTMLInputElement>('input[data-kind="moment"]') ?? [])];
}

function sayUtc(field: HTMLInputElement): void {
  const place = document.getElementById(`${field.name}-utc`);
  const at = momentOf(field);
  if (place) place.textContent = at ? `${wallOf(Math.floor(Date.parse(at) / MINUTE_MS) * MINUTE_MS, "UTC").slice(0, 16).replace("T", " ")} UTC` : "";
}
