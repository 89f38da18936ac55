// Forms that act: `<form data-act="POST /api/v1/…" data-then="…">` sends its fields as JSON to the API.
//
// A field's `data-kind` is the type of its text: number, boolean, lines (a list), nullable (empty is null), optional
// (empty is left out), days (sent as seconds) or moment. A moment is a date in the form's time zone, sent as UTC.
// `data-match` is an If-Match.
//
// `data-then` is reload, goto:/path, refresh:#id (htmx fetches that part of the page again) or close. A path may
// contain {name}, which a field or, after a response, the response fills in.

import { call } from "./api.js";
import { momentOf } from "./moments.js";
import { sayError, toast } from "./notices.js";
import { refresh } from "./refresh.js";

type Field = HTMLInputElement | HTMLSelectElement | HTMLTextAreaElement;

export function installActs(): void {
  document.addEventListener("submit", (event) => {
    const form = event.target;
    if (!(form instanceof HTMLFormElement) || !form.dataset["act"]) return;
    event.preventDefault();
    void act(form);
  });
}

async function act(form: HTMLFormElement): Promise<void> {
  const [method = "POST", path = ""] = (form.dataset["act"] ?? "").split(" ");
  const said = form.querySelector<HTMLElement>(".said");
  const button = form.querySelector<HTMLButtonElement>('[type="submit"]');
  const values = valuesOf(form);
  const match = form.dataset["match"];
  said?.replaceChildren();
  if (button) button.disabled = true;
  form.setAttribute("aria-busy", "true");
  try {
    const { where, rest } = filled(path, values);
    const body = method === "GET" || (method === "DELETE" && !Object.keys(rest).length) ? undefined : rest;
    const answer = await call<Record<string, unknown> | null>(method, where, body, match ? { "If-Match": match } : {});
    form.dispatchEvent(new CustomEvent("acted", { bubbles: true, detail: answer }));
    follow(form, answer ?? {});
  } catch (error) {
    if (said) sayError(said, error);
    else toast(String(error));
  } finally {
    if (button) button.disabled = false;
    form.removeAttribute("aria-busy");
  }
}

function follow(form: HTMLFormElement, answer: Record<string, unknown>): void {
  const [word = "reload", ...rest] = (form.dataset["then"] ?? "reload").split(":");
  const at = rest.join(":");
  form.closest("dialog")?.close();
  if (form.dataset["toast"]) toast(form.dataset["toast"]);
  if (word === "goto") location.assign(filled(at, answer).where);
  else if (word === "refresh") void refresh(at);
  else if (word === "reload") location.reload();
}

/** The path with its {names} filled in from the values, and the values that are left. */
export function filled(path: string, values: Record<string, unknown>): { where: string; rest: Record<string, unknown> } {
  const rest = { ...values };
  const where = path.replaceAll(/\{(\w+)\}/g, (_, name: string) => {
    const value = String(rest[name] ?? "");
    delete rest[name];
    return encodeURIComponent(value);
  });
  return { where, rest };
}

/** The form's fields by name, as JSON values; `a.b` is the member `b` of an object `a`. */
export function valuesOf(form: HTMLFormElement): Record<string, unknown> {
  const all: Record<string, unknown> = {};
  for (const field of form.elements) {
    if (!isField(field) || !field.name || field.disabled) continue;
    const value = valueOf(field);
    if (value === undefined) continue;
    const [name = "", member = ""] = field.name.split(".").reverse();
    const values = member ? ((all[member] ??= {}) as Record<string, unknown>) : all;
    const known = values[name];
    values[name] = field.dataset["kind"] === "many" ? [...(Array.isArray(known) ? known : []), value] : value;
  }
  return all;
}

function isField(element: Element): element is Field {
  return (
    element instanceof HTMLInputElement || element instanceof HTMLSelectElement || element instanceof HTMLTextAreaElement
  );
}

function valueOf(field: Field): unknown {
  if (field instanceof HTMLInputElement && field.type === "checkbox") {
    return field.dataset["kind"] === "many" ? (field.checked ? field.value : undefined) : field.checked;
  }
  if (field instanceof HTMLInputElement && field.type === "radio" && !field.checked) return undefined;
  const text = field.value;
  switch (field.dataset["kind"]) {
    case "number":
      return text === "" ? undefined : Number(text);
    case "nullable-number":
      return text === "" ? null : Number(text);
    case "days": // kept as seconds
      return text === "" ? undefined : Math.round(Number(text) * 86_400);
    case "moment":
      return field instanceof HTMLInputElement ? momentOf(field) : undefined;
    case "boolean":
      return text === "true";
    case "lines":
      return text.split("\n").map((line) => line.trim()).filter(Boolean);
    case "nullable":
      return text === "" ? null : text;
    case "optional":
      return text === "" ? undefined : text;
    default:
      return text;
  }
}
