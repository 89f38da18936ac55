// Shared code of a sequence's page: finding its parts, reading their data, drawing a cursor.

/** The element for this selector. Throws if the page lacks it, which is our fault. */
export function part<E extends Element = HTMLElement>(root: ParentNode, selector: string): E {
  const found = root.querySelector<E>(selector);
  if (!found) throw new Error(`the page has no ${selector}`);
  return found;
}

/** The data that the page brings along in a script of JSON. */
export function pageData<T>(id: string): T {
  return JSON.parse(part(document, `#${id}`).textContent ?? "null") as T;
}

/** Put the cursors of plots at this share of their width, 0 to 1. */
export function placeCursors(root: ParentNode, share: number): void {
  for (const cursor of root.querySelectorAll<SVGPathElement>("[data-cursor]")) {
    const height = cursor.ownerSVGElement?.viewBox.baseVal.height ?? 120;
    cursor.setAttribute("visibility", "visible");
    cursor.setAttribute("d", `M${(1000 * share).toFixed(1)} 0V${height}`);
  }
}

/** The place of the value nearest to `wanted` in ascending values. */
export function nearest(values: readonly number[], wanted: number): number {
  let low = 0;
  let high = values.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((values[middle] ?? 0) < wanted) low = middle + 1;
    else high = middle;
  }
  const before = Math.max(0, low - 1);
  return wanted - (values[before] ?? 0) < (values[low] ?? 0) - wanted ? before : low;
}

/** Calls `move` with the pointer's share of the element's width during a drag. */
export function onDrag(element: Element, move: (share: number) => void): void {
  const at = (event: PointerEvent): void => {
    const box = element.getBoundingClientRect();
    move(Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)));
  };
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture((event as PointerEvent).pointerId);
    at(event as PointerEvent);
  });
  element.addEventListener("pointermove", (event) => {
    if ((event as PointerEvent).buttons & 1) at(event as PointerEvent);
  });
}
