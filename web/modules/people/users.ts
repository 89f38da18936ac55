// Users, for administrators: passwords are suggested by the browser, and shown once to be handed over.

import { showOnce } from "./once.js";

const LETTERS = "abcdefghijkmnpqrstuvwxyz23456789";
const GROUPS = 5;
const GROUP = 4;

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element ? event.target.closest("[data-suggest]") : null;
  const input = button?.closest("[data-password]")?.querySelector("input");
  if (input) input.value = suggested();
});

document.addEventListener("acted", (event) => {
  const form = event.target;
  if (!(form instanceof HTMLFormElement) || !form.hasAttribute("data-shows-password")) return;
  const password = valueOf(form, "password");
  const name = form.dataset["name"] ?? valueOf(form, "name");
  form.reset();
  form.closest("dialog")?.close(); // first, so that the focus moves to the password
  if (password) showOnce(password, `New password of ${name}`);
});

/** 100 random bits in groups that can be read aloud: 20 of 32 letters that are not taken for others. */
export function suggested(): string {
  const random = crypto.getRandomValues(new Uint8Array(GROUPS * GROUP));
  const letters = [...random].map((byte) => LETTERS[byte % LETTERS.length] ?? "");
  return Array.from({ length: GROUPS }, (_, group) => letters.slice(group * GROUP, (group + 1) * GROUP).join("")).join("-");
}

function valueOf(form: HTMLFormElement, name: string): string {
  const field = form.elements.namedItem(name);
  return field instanceof HTMLInputElement ? field.value : "";
}
