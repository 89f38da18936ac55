// The form with the metadata of all uploaded sequences: their calibration, and whether they are processed.
//
// It preselects only the calibration last used with the robot that the reader names. The newest one may be another
// robot's, and labels made with it look right and are wrong.

import type { Kept } from "./calibration_file.js";

export function mountFacts(form: HTMLFormElement): void {
  const select = calibrationOf(form);
  const robot = form.querySelector<HTMLInputElement>('[name="platform"]');
  const known = JSON.parse(form.dataset["ofRobots"] ?? "{}") as Record<string, string>;
  let chosenFor = ""; // the robot for which it was chosen here, and not by the reader
  robot?.addEventListener("input", () => {
    const name = robot.value.trim();
    const id = Object.hasOwn(known, name) ? known[name]! : "";
    if (!select || (select.value && !chosenFor) || name === chosenFor) return;
    chosenFor = id ? name : "";
    choose(form, id, id ? `last used with ${name}` : "");
  });
  select?.addEventListener("change", () => {
    chosenFor = "";
    choose(form, select.value, "");
  });
  if (select) choose(form, select.value, ""); // the browser restored the form
}

/** Adds a calibration to the choices and selects it; returns whether there is such a form. */
export function chooseCalibration(form: HTMLFormElement | null, { id, name, version }: Kept): boolean {
  const select = form && calibrationOf(form);
  if (!select) return false;
  if (![...select.options].some((option) => option.value === id)) select.add(new Option(`${name}, version ${version}`, id));
  select.value = id;
  select.dispatchEvent(new Event("change"));
  form.querySelector("[data-no-calibration]")?.remove();
  return true;
}

function choose(form: HTMLFormElement, id: string, hint: string): void {
  const select = calibrationOf(form);
  if (select) select.value = id;
  const said = form.querySelector<HTMLElement>("[data-calibration-hint]");
  if (said) said.textContent = hint;
  const process = form.querySelector<HTMLInputElement>('[name="process"]');
  if (!process || process.disabled === !id) return;
  process.disabled = !id;
  process.checked = id !== "";
}

function calibrationOf(form: HTMLFormElement): HTMLSelectElement | null {
  return form.querySelector<HTMLSelectElement>('[name="calibration_id"]');
}
