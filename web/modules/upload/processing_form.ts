// The form that has a sequence processed: what is left empty is left out, so that it is as the platform has it.

import { call } from "../api.js";
import { sayError } from "../notices.js";

/** What is asked for, as `POST /sequences/{id}/process` reads it. */
export function asked(form: HTMLFormElement): Record<string, unknown> {
  const fields = new FormData(form);
  const topics = ["odometry_topic", "lidar_topic"].map((name) => [name, String(fields.get(name) ?? "").trim()]);
  const profile = fields.get("profile");
  const grid = String(fields.get("grid") ?? "");
  const parameters = [...form.querySelectorAll<HTMLInputElement>("[data-parameter]")]
    .filter((field) => field.value !== "")
    .map((field) => [field.dataset["parameter"], field.valueAsNumber]);
  return {
    ...keptFrom(form),
    ...(profile ? { profile: String(profile) } : {}),
    ...(grid && grid !== "paper" ? { grid } : {}),
    ...(fields.get("ground") ? { ground: "auto" } : {}),
    parameters: Object.fromEntries(parameters),
    stages: String(fields.get("stages") ?? "synchronise,label").split(","),
    ...Object.fromEntries(topics.filter(([, topic]) => topic)),
  };
}

/** What the run before was asked for and the form has no fields for: only where it was filled in from a run. */
function keptFrom(form: HTMLFormElement): Record<string, unknown> {
  return JSON.parse(form.dataset["kept"] ?? "{}") as Record<string, unknown>;
}

export function mountProcessing(form: HTMLFormElement): void {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void start(form);
  });
}

async function start(form: HTMLFormElement): Promise<void> {
  const said = form.querySelector<HTMLElement>(".said");
  const button = form.querySelector<HTMLButtonElement>('[type="submit"]');
  said?.replaceChildren();
  if (button) button.disabled = true;
  try {
    await call("POST", `/api/v1/sequences/${form.dataset["process"]}/process`, asked(form));
    location.assign(`/sequences/${form.dataset["process"]}`);
  } catch (error) {
    if (said) sayError(said, error);
    if (button) button.disabled = false;
  }
}
