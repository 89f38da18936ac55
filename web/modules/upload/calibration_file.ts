// A calibration file on a page: sent to be checked and stored, with a line in the list of dropped files.

import { call, RefusedError } from "../api.js";
import { findingOf } from "./row.js";

/** A calibration as `POST /calibrations` answers it. */
export interface Kept {
  id: string;
  name: string;
  version: number;
  format: string;
  sensors: unknown[];
  findings: { code: string; severity: string; message: string }[];
}

interface Shown {
  state: "ready" | "refused" | "running";
  words: string;
  line: string;
  link?: string;
  findings: HTMLLIElement[];
}

const LARGEST_BYTES = 2 ** 20;
const CALIBRATION = /\.(ya?ml|json|zip)$/i;

/** Whether the file might be a calibration; only the platform can decide. */
export function mayBeCalibration(file: File): boolean {
  return CALIBRATION.test(file.name) && file.size > 0 && file.size <= LARGEST_BYTES;
}

/** Has the file checked and stored; a known file returns the existing calibration. Throws `RefusedError`. */
export function keep(file: File): Promise<Kept> {
  const form = new FormData();
  form.append("file", file, file.name);
  return call<Kept>("POST", "/api/v1/calibrations", form);
}

/** The line of a file that is being read. */
export function calibrationLine(file: File): HTMLLIElement {
  const item = Object.assign(document.createElement("li"), { className: "transfer" });
  draw(item, file.name, { state: "running", words: "reading", line: "", findings: [] });
  return item;
}

/** Shows in its line that it was stored, and the findings; `next` is the consequence on this page. */
export function showKept(item: HTMLLIElement, file: File, kept: Kept, next = ""): void {
  const noticed = kept.findings.length ? "Findings:" : "All checks passed.";
  const line = `${kept.name}, version ${kept.version}: ${kept.sensors.length} sensors, format ${kept.format}. ${next}${noticed}`;
  const findings = kept.findings.map(({ code, severity, message }) => findingOf(code, severity, message));
  draw(item, file.name, { state: "ready", words: "added", line, link: `/calibrations/${kept.id}`, findings });
}

/** Shows in its line why it was refused. */
export function showRefused(item: HTMLLIElement, file: File, error: unknown): void {
  const findings = reasonsOf(error).map(({ code, sentence }) => findingOf(code, "error", sentence));
  draw(item, file.name, { state: "refused", words: "refused", line: "Not added. Fix the file and drop it again.", findings });
}

/** Why it was refused, with the codes. */
export function reasonsOf(error: unknown): { code: string; sentence: string }[] {
  if (!(error instanceof RefusedError)) return [{ code: "error", sentence: String(error) }];
  const { errors, code, detail } = error.problem;
  if (!errors?.length) return [{ code, sentence: detail }];
  return errors.map((one) => ({ code: one.code, sentence: one.detail ?? detail }));
}

function draw(item: HTMLLIElement, name: string, shown: Shown): void {
  const head = Object.assign(document.createElement("div"), { className: "transfer-head" });
  const state = Object.assign(document.createElement("span"), { className: "state", textContent: shown.words });
  state.dataset["state"] = shown.state;
  head.append(Object.assign(document.createElement("strong"), { textContent: name }), state);
  const line = Object.assign(document.createElement("p"), { className: "transfer-line", textContent: shown.line });
  if (shown.link) line.append(" ", Object.assign(document.createElement("a"), { href: shown.link, textContent: "Open" }));
  const list = Object.assign(document.createElement("ul"), { className: "findings", hidden: !shown.findings.length });
  list.append(...shown.findings);
  item.replaceChildren(head, line, list);
}
