// Messages to the reader: a refusal beside its form, a short notice at the edge of the page.

import { type Problem, RefusedError } from "./api.js";

const SHOWN = 10;

/** Shows the reason of a refusal in `place`: the sentence, and the first findings. */
export function sayProblem(place: HTMLElement, problem: Problem): void {
  const sentence = document.createElement("p");
  sentence.textContent = problem.detail || problem.title;
  const findings = problem.errors ?? [];
  place.replaceChildren(sentence);
  if (findings.length) {
    const list = document.createElement("ul");
    for (const one of findings.slice(0, SHOWN)) {
      const item = document.createElement("li");
      item.textContent = lineOf(one);
      list.append(item);
    }
    const total = problem.errors_total ?? findings.length;
    if (total > SHOWN) list.append(Object.assign(document.createElement("li"), { textContent: `and ${total - SHOWN} more` }));
    place.append(list);
  }
  if (problem.request_id) {
    place.append(Object.assign(document.createElement("p"), { className: "hint", textContent: `Request ${problem.request_id}` }));
  }
  place.dataset["tone"] = "error";
}

/** One finding as a line: for a field of a form its sentence, for a file the expected and the actual value. */
function lineOf({ code, file, frame, where, expected, actual, detail }: NonNullable<Problem["errors"]>[number]): string {
  if (detail) return [where, detail].filter(Boolean).join(": ");
  const place = [file, frame, where].filter(Boolean).join(" ");
  const values = [expected && `expected ${expected}`, actual && `found ${actual}`].filter(Boolean).join(", ");
  return [place, code.replaceAll("_", " "), values].filter(Boolean).join(": ");
}

/** Shows a thrown value as a sentence in `place`. */
export function sayError(place: HTMLElement, error: unknown): void {
  if (error instanceof RefusedError) sayProblem(place, error.problem);
  else sayProblem(place, { title: "Error", status: 0, detail: String(error), code: "error", request_id: "" });
}

/** A passing word at the edge of the page, read out by screen readers. */
export function toast(sentence: string, lasts_ms = 6000): void {
  const one = Object.assign(document.createElement("p"), { className: "toast", textContent: sentence });
  document.getElementById("toasts")?.append(one);
  setTimeout(() => one.remove(), lasts_ms);
}
