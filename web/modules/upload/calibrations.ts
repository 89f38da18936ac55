// Dropped calibration files: stored at once or refused with findings, and assigned to the sequence of the panel.

import { call } from "../api.js";
import { refresh } from "../refresh.js";
import type { Found } from "./bags.js";
import { calibrationLine, keep, showKept, showRefused } from "./calibration_file.js";
import { chosen } from "./dropped_files.js";
import { listenForDrops } from "./panel.js";

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
  takeChosen(); // files chosen before this module was loaded
  listenForDrops(root.querySelector("[data-drop]"), take);
}

async function bring(root: HTMLElement, file: File): Promise<void> {
  const item = calibrationLine(file);
  root.querySelector("[data-results]")?.prepend(item);
  try {
    const kept = await keep(file);
    const sequenceId = root.dataset["sequence"];
    if (sequenceId) {
      await call("PUT", `/api/v1/sequences/${sequenceId}/calibration`, { calibration_id: kept.id });
      // A reload shows the findings in the panel, but would interrupt uploads on a page with an uploader.
      if (!document.querySelector("[data-uploader]")) return location.reload();
    }
    showKept(item, file, kept);
    for (const part of ["#calibrations", "#process"]) if (document.querySelector(part)) await refresh(part);
    root.dispatchEvent(new CustomEvent("calibrated", { bubbles: true, detail: kept }));
  } catch (error) {
    showRefused(item, file, error);
  }
}
