// The form that has a sequence processed: empty fields are left out, so that the platform's defaults apply.

import { call } from "../api.js";
import { sayError } from "../notices.js";

/** The request body of `POST /sequences/{id}/process`. */
export function asked(form: HTMLFormElement): Record<string, unknown> {
  const fields = new FormData(form);
  const topics = ["odometry_topic", "lidar_topic"].map((name) => [name, String(fields.get(name) ?? "").trim()]);
  const profile = fields.get("profile");
  const grid = String(fields.get("grid") ?? "");
  const kept = keptFrom(form);
  const parameters = [...form.querySelectorAll<HTMLInputElement>("[data-parameter]")]
    .filter((field) => field.value !== "")
    .map((field) => [field.dataset["parameter"], field.valueAsNumber]);
  return {
    ...kept,
    ...(profile ? { profile: String(profile) } : {}),
    ...(grid && grid !== "paper" ? { grid } : {}),
    ...(fields.get("ground") ? { ground: "auto" } : {}),
    parameters: { ...(kept["parameters"] as object | undefined), ...Object.fromEntries(parameters) },
    stages: String(fields.get("stages") ?? "synchronise,label").split(","),
    ...Object.fromEntries(topics.filter(([, topic]) => topic)),
  };
}

/** The values of the previous run without a field in the form; all of them if the form is only a button. */
function keptFrom(form: HTMLFormElement): Record<string, unknown> {
  return JSON.parse(form.dataset["kept"] ?? "{}") as Record<string, unknown>;
}

export function mountProcessing(form: HTMLFormElement): void {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void start(form);
  });
  form.addEventListener("change", () => showDefaults(form));
  showDefaults(form); // the browser restored the profile
}

/** Shows the chosen profile's defaults in empty fields. */
function showDefaults(form: HTMLFormElement): void {
  const profile = String(new FormData(form).get("profile") ?? "");
  for (const field of form.querySelectorAll<HTMLInputElement>("[data-parameter]")) field.placeholder = field.dataset[profile] ?? field.placeholder;
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
