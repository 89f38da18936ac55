// The behaviour of `parts/uploading.html`: bags, calibrations, the processing of a sequence.

import { call } from "../api.js";
import { messageOf } from "../errors.js";
import { refresh } from "../refresh.js";
import { toast } from "../notices.js";
import { mountCalibrations } from "./calibrations.js";
import { mountFacts } from "./facts.js";
import { Panel, type Registered } from "./panel.js";
import { mountProcessing } from "./processing_form.js";

const AFTER_A_RECORDING = ["#recordings", "#process"];

for (const root of document.querySelectorAll<HTMLElement>("[data-uploader]")) new Panel(root);
for (const root of document.querySelectorAll<HTMLElement>("[data-calibrations]")) mountCalibrations(root);
for (const form of document.querySelectorAll<HTMLFormElement>("form[data-bags]")) mountFacts(form);
for (const form of document.querySelectorAll<HTMLFormElement>("form[data-process]")) mountProcessing(form);

addEventListener("registered", (event) => void registered((event as CustomEvent<Registered>).detail));
addEventListener("bags", (event) => countBags(Number((event as CustomEvent<number>).detail)));

/** Refreshes the sequence's part of the page and, if requested, starts its processing once its recordings are complete.
 * */
async function registered({ sequenceId, isWhole }: Registered): Promise<void> {
  for (const part of AFTER_A_RECORDING) if (document.querySelector(part)) await refresh(part);
  const wish = document.querySelector<HTMLInputElement>('form[data-bags] [name="process"]');
  const calibration = document.querySelector<HTMLSelectElement>('form[data-bags] [name="calibration_id"]');
  if (!isWhole || !wish?.checked || !calibration?.value) return;
  try {
    await call("POST", `/api/v1/sequences/${sequenceId}/process`, {});
    toast("Processing started.");
  } catch (error) {
    toast(messageOf(error));
  }
}

/** Shows the number of bags on the start button. */
function countBags(count: number): void {
  const button = document.querySelector<HTMLButtonElement>("form[data-bags] [data-begin]");
  if (!button) return;
  button.disabled = !count;
  button.textContent = count > 1 ? `Upload ${count} bags` : "Upload";
}
