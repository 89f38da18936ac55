// Copying a table: `data-copies-file="/api/v1/…"` fetches a file's text and puts it on the clipboard.

import { bytes, RefusedError } from "../api.js";
import { putOnClipboard } from "../clipboard.js";
import { toast } from "../notices.js";

export function installCopying(): void {
  document.addEventListener("click", (event) => {
    if (!(event.target instanceof Element)) return;
    const button = event.target.closest<HTMLButtonElement>("[data-copies-file]");
    if (button) void copyFrom(button);
  });
}

async function copyFrom(button: HTMLButtonElement): Promise<void> {
  button.disabled = true;
  try {
    const text = new TextDecoder().decode(await bytes(button.dataset["copiesFile"] ?? ""));
    await putOnClipboard(text);
    toast(`${(button.textContent ?? "").replace("Copy ", "")} copied: ${text.split("\n").length - 1} lines.`);
  } catch (error) {
    toast(error instanceof RefusedError ? error.problem.detail : "Could not copy. Download the file instead.");
  } finally {
    button.disabled = false;
  }
}
