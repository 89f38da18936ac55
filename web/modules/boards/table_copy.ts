// Copying a table: `data-copies="/api/v1/…"` fetches a file's text and puts it on the clipboard.

import { bytes, RefusedError } from "../api.js";
import { toast } from "../notices.js";

export function installCopying(): void {
  document.addEventListener("click", (event) => {
    if (!(event.target instanceof Element)) return;
    const button = event.target.closest<HTMLButtonElement>("[data-copies]");
    if (button) void copyFrom(button);
  });
}

async function copyFrom(button: HTMLButtonElement): Promise<void> {
  button.disabled = true;
  try {
    const text = new TextDecoder().decode(await bytes(button.dataset["copies"] ?? ""));
    await put(text);
    toast(`${(button.textContent ?? "").replace("Copy ", "")} copied: ${text.split("\n").length - 1} lines.`);
  } catch (error) {
    toast(error instanceof RefusedError ? error.problem.detail : "Could not copy. Download the file instead.");
  } finally {
    button.disabled = false;
  }
}

/** On the clipboard; by a selection where the browser keeps the clipboard from pages (plain HTTP). */
async function put(text: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    putBySelection(text);
  }
}

function putBySelection(text: string): void {
  const area = document.createElement("textarea");
  area.value = text;
  area.className = "visually-hidden";
  area.setAttribute("aria-hidden", "true");
  document.body.append(area);
  area.select();
  const isCopied = document.execCommand("copy");
  area.remove();
  if (!isCopied) throw new Error("the browser does not let pages copy");
}
