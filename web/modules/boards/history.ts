// The slider of a board's history: each stop is a link of the list below it, whose board replaces this one.

import { refresh } from "../refresh.js";

const BOARD = "#board";
const SETTLES_MS = 150;

export function installHistory(): void {
  const slider = document.querySelector<HTMLInputElement>("#when");
  const said = document.querySelector<HTMLOutputElement>("#when-said");
  const stops = [...document.querySelectorAll<HTMLLIElement>("#when-changes > li")];
  if (!slider || !said || stops.length === 0) return;
  let waiting = 0;
  tell(slider, said, stops);
  slider.addEventListener("input", () => {
    tell(slider, said, stops);
    clearTimeout(waiting);
    waiting = setTimeout(() => void show(stops[slider.valueAsNumber]), SETTLES_MS);
  });
}

/** Shows the time of the chosen stop and its changes. */
function tell(slider: HTMLInputElement, said: HTMLOutputElement, stops: readonly HTMLLIElement[]): void {
  const stop = stops[slider.valueAsNumber];
  const when = stop?.querySelector("time")?.textContent ?? "";
  const what = stop?.querySelector("span")?.textContent ?? "";
  const isNow = slider.valueAsNumber === stops.length - 1;
  const sentence = [isNow ? `now, since ${when}` : when, what].filter(Boolean).join(" · ");
  said.textContent = sentence;
  slider.setAttribute("aria-valuetext", sentence);
}

/** Replaces the board by the stop's; the URL follows, so that it can be shared. */
async function show(stop: HTMLLIElement | undefined): Promise<void> {
  const link = stop?.querySelector("a");
  if (!link) return;
  history.replaceState(null, "", link.href);
  await refresh(BOARD);
}
