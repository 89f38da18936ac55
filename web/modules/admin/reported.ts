// The editor of reported rows: rows come and go here, and are put back all at once.

import { call } from "../api.js";
import { sayError, toast } from "../notices.js";

type Field = HTMLInputElement | HTMLSelectElement;

const TEXTS = ["method", "modality", "kind", "source", "note"];

for (const section of document.querySelectorAll<HTMLElement>("[data-reported]")) install(section);

function install(section: HTMLElement): void {
  const form = section.querySelector("form");
  const rows = section.querySelector<HTMLElement>("[data-reported-rows]");
  const blank = rows?.querySelector<HTMLElement>("[data-reported-blank]");
  if (!form || !rows || !blank) return;
  section.querySelector("[data-reported-add]")?.addEventListener("click", () => add(rows, blank));
  rows.addEventListener("click", (event) => {
    if (event.target instanceof Element && event.target.closest("[data-reported-drop]")) event.target.closest("tr")?.remove();
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void save(section, form, rows);
  });
}

function add(rows: HTMLElement, blank: HTMLElement): void {
  const row = blank.cloneNode(true);
  if (!(row instanceof HTMLElement)) return;
  row.hidden = false;
  delete row.dataset["reportedBlank"];
  for (const field of row.querySelectorAll<Field>("[data-field]")) field.disabled = false;
  rows.append(row);
  row.querySelector<HTMLInputElement>("input")?.focus();
}

async function save(section: HTMLElement, form: HTMLFormElement, rows: HTMLElement): Promise<void> {
  const said = section.querySelector<HTMLElement>(".said");
  const reason = form.querySelector<HTMLInputElement>("[name=reason]");
  const shown = [...rows.querySelectorAll<HTMLElement>("tr:not([data-reported-blank])")];
  if (!said || !reason) return;
  said.replaceChildren();
  try {
    await call("PUT", section.dataset["reported"] ?? "", { rows: shown.map(valuesOf), reason: reason.value });
    reason.value = "";
    toast(shown.length === 1 ? "1 reported row saved." : `${shown.length} reported rows saved.`);
  } catch (error) {
    sayError(said, error);
  }
}

function valuesOf(row: HTMLElement): Record<string, string | number | null> {
  const values: Record<string, string | number | null> = {};
  for (const field of row.querySelectorAll<Field>("[data-field]")) {
    const name = field.dataset["field"] ?? "";
    if (TEXTS.includes(name)) values[name] = field.value;
    else values[name] = field.value === "" ? null : Number(field.value);
  }
  return values;
}
