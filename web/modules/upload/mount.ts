// What `parts/uploading.html` needs to be alive: bags, calibrations, the processing of a sequence.

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

/** What the page says of it is fetched again, and where it was asked for, the sequence is processed once it is whole. */
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

/** The button that begins says how many bags it begins with. */
function countBags(count: number): void {
  const button = document.querySelector<HTMLButtonElement>("form[data-bags] [data-begin]");
  if (!button) return;
  button.disabled = !count;
  button.textContent = count > 1 ? `Upload ${count} bags` : "Upload";
}
