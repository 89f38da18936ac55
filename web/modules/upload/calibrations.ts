// Calibration files that are dropped: kept at once or refused with findings; pinned where a sequence asked for one.

import { call, RefusedError } from "../api.js";
import { refresh } from "../refresh.js";
import type { Found } from "./bags.js";
import { chosen } from "./dropped_files.js";
import { listenForDrops } from "./panel.js";
import { findingOf } from "./row.js";

interface Kept {
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

export function mountCalibrations(root: HTMLElement): void {
  const input = root.querySelector<HTMLInputElement>("[data-files]");
  const take = (found: Found[]): void => {
    for (const { file } of found) void bring(root, file);
  };
  root.querySelector("[data-choose]")?.addEventListener("click", () => input?.click());
  const takeChosen = (): void => {
    if (input?.files?.length) take(chosen(input.files));
    if (input) input.value = "";
  };
  input?.addEventListener("change", takeChosen);
  takeChosen(); // what was chosen before this module was there
  listenForDrops(root.querySelector("[data-drop]"), take);
}

async function bring(root: HTMLElement, file: File): Promise<void> {
  const item = Object.assign(document.createElement("li"), { className: "transfer" });
  root.querySelector("[data-results]")?.prepend(item);
  draw(item, file.name, { state: "running", words: "being read", line: "", findings: [] });
  const form = new FormData();
  form.append("file", file, file.name);
  try {
    const kept = await call<Kept>("POST", "/api/v1/calibrations", form);
    const sequenceId = root.dataset["sequence"];
    if (sequenceId) {
      await call("PUT", `/api/v1/sequences/${sequenceId}/calibration`, { calibration_id: kept.id });
      // Its panel says what was noticed, and a part fetched meanwhile would be older; but no upload is broken off.
      if (!document.querySelector("[data-uploader]")) return location.reload();
    }
    draw(item, file.name, keptAs(kept));
    for (const part of ["#calibrations", "#process"]) if (document.querySelector(part)) await refresh(part);
    root.dispatchEvent(new CustomEvent("calibrated", { bubbles: true, detail: kept }));
  } catch (error) {
    draw(item, file.name, refusedAs(error));
  }
}

function keptAs(kept: Kept): Shown {
  const noticed = kept.findings.length ? "What was noticed:" : "Every check passed.";
  const line = `${kept.name}, version ${kept.version}: ${kept.sensors.length} sensors, read as ${kept.format}. ${noticed}`;
  const findings = kept.findings.map(({ code, severity, message }) => findingOf(code, severity, message));
  return { state: "ready", words: "kept", line, link: `/calibrations/${kept.id}`, findings };
}

function refusedAs(error: unknown): Shown {
  const problem = error instanceof RefusedError ? error.problem : undefined;
  const found = problem?.errors?.length
    ? problem.errors.map((one) => findingOf(one.code, "error", one.expected ?? problem.detail))
    : [findingOf(problem?.code ?? "error", "error", problem?.detail ?? String(error))];
  const line = "Nothing was kept. Correct the file and drop it again.";
  return { state: "refused", words: "refused", line, findings: found };
}

function draw(item: HTMLLIElement, name: string, shown: Shown): void {
  const head = Object.assign(document.createElement("div"), { className: "transfer-head" });
  const state = Object.assign(document.createElement("span"), { className: "state", textContent: shown.words });
  state.dataset["state"] = shown.state;
  head.append(Object.assign(document.createElement("strong"), { textContent: name }), state);
  const line = Object.assign(document.createElement("p"), { className: "transfer-line", textContent: shown.line });
  if (shown.link) line.append(" ", Object.assign(document.createElement("a"), { href: shown.link, textContent: "Look at it" }));
  const list = Object.assign(document.createElement("ul"), { className: "findings", hidden: !shown.findings.length });
  list.append(...shown.findings);
  item.replaceChildren(head, line, list);
}
