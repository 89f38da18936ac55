// The page's colours as the graphics card wants them: read from the tokens, again whenever the theme changes.

import type { Mode } from "../looks.js";
import { FADED, NO_VALUE, RAMP_FIRST, RAMP_LAST } from "../looks.js";
import { type RampName, type Rgb, ramp } from "../ramps.js";

export type { Rgb };

export interface Theme {
  paper: Rgb;
  sheet: Rgb;
  ink: Rgb;
  soft: Rgb;
  line: Rgb;
  accent: Rgb;
  track: Rgb;
  unseen: Rgb;
  /** T, P, N. */
  classes: [Rgb, Rgb, Rgb];
  /** By code of `DIFFERENCES`, from 1. */
  differences: Rgb[];
}

export function themeOf(element: Element): Theme {
  const style = getComputedStyle(element);
  const token = (name: string): Rgb => hex(style.getPropertyValue(name).trim());
  return {
    paper: token("--paper"),
    sheet: token("--sheet"),
    ink: token("--ink"),
    soft: token("--ink-soft"),
    line: token("--line"),
    accent: token("--accent"),
    track: token("--track"),
    unseen: token("--unseen"),
    classes: [token("--t"), token("--p"), token("--n")],
    differences: ["--same", "--only-a", "--only-b", "--easier", "--harder"].map(token),
  };
}

/** Calls back when the reader or their system changes the theme or the class colours; the returned function stops this.
 * */
export function onThemeChange(changed: () => void): () => void {
  const system = matchMedia("(prefers-color-scheme: dark)");
  const observer = new MutationObserver(changed);
  observer.observe(document.documentElement, { attributeFilter: ["data-theme", "data-colours"] });
  system.addEventListener("change", changed);
  return () => {
    observer.disconnect();
    system.removeEventListener("change", changed);
  };
}

/** 256 colours as RGBA: classes, classes that were not seen, and the mode's ramp. */
export function paletteOf(theme: Theme, mode: Mode): Uint8Array {
  const palette = new Uint8Array(1024).fill(255);
  const put = (index: number, colour: Rgb): void => palette.set(colour, index * 4);
  theme.classes.forEach((colour, number) => {
    put(number + 1, colour);
    put(number + 1 + FADED, mixed(colour, mixed(theme.unseen, theme.paper, 0.45), 0.6));
  });
  if (mode === "difference") theme.differences.forEach((colour, number) => put(number + 1, colour));
  for (let index = RAMP_FIRST; index <= RAMP_LAST; index++) {
    put(index, ramp(rampOf(mode), (index - RAMP_FIRST) / (RAMP_LAST - RAMP_FIRST)));
  }
  put(NO_VALUE, theme.unseen);
  return palette;
}

export function rampOf(mode: Mode): RampName {
  if (mode === "confidence") return "lighter";
  return mode === "d2" ? "inferno" : "viridis";
}

export function mixed(a: Rgb, b: Rgb, share: number): Rgb {
  return [0, 1, 2].map((c) => Math.round(a[c]! * (1 - share) + b[c]! * share)) as unknown as Rgb;
}

function hex(text: string): Rgb {
  const value = Number.parseInt(text.slice(1), 16);
  return [(value >> 16) & 255, (value >> 8) & 255, value & 255];
}
