// Progress of an upload: a bar, the bytes sent, and rate and time left from the last seconds.

import type { Heard } from "./file_upload.js";
import { sized } from "./verdict.js";

const SPOKEN_MS = 400;
const WINDOW_MS = 4000;

export function meter(form: HTMLFormElement): Heard {
  const bar = form.querySelector<HTMLProgressElement>("#sending-bar");
  const act = form.querySelector<HTMLElement>("#sending-act");
  const rate = form.querySelector<HTMLElement>("#sending-rate");
  let marks: { at_ms: number; done_bytes: number }[] = [];
  let spoken_ms = 0;
  return {
    act: (name) => {
      marks = [];
      if (act) act.textContent = name;
      if (rate) rate.textContent = "";
      if (bar) bar.value = 0;
    },
    bytes: (done_bytes, total_bytes) => {
      const at_ms = performance.now();
      marks = [...marks.filter((mark) => at_ms - mark.at_ms < WINDOW_MS), { at_ms, done_bytes }];
      if (bar) bar.value = total_bytes ? done_bytes / total_bytes : 1;
      if (!rate || (at_ms - spoken_ms < SPOKEN_MS && done_bytes < total_bytes)) return;
      spoken_ms = at_ms;
      rate.textContent = rateSaid(marks, done_bytes, total_bytes);
    },
  };
}

/** `41 of 63 MB · 12 MB/s · 2 s left`. */
function rateSaid(marks: { at_ms: number; done_bytes: number }[], done_bytes: number, total_bytes: number): string {
  const [first, last] = [marks[0], marks.at(-1)];
  const said = [`${sized(done_bytes)} of ${sized(total_bytes)}`];
  const passed_s = first && last ? (last.at_ms - first.at_ms) / 1000 : 0;
  if (first && last && passed_s > 0.5 && last.done_bytes > first.done_bytes) {
    const rate_hz = (last.done_bytes - first.done_bytes) / passed_s;
    said.push(`${sized(rate_hz)}/s`, `${Math.ceil((total_bytes - done_bytes) / rate_hz)} s left`);
  }
  return said.join(" · ");
}
