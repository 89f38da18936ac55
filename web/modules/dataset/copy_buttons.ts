// Buttons that copy: `data-copies` is the text.

import { putOnClipboard } from "../clipboard.js";
import { toast } from "../notices.js";

const SHOWN_MS = 20_000;

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element ? event.target.closest<HTMLElement>("[data-copies]") : null;
  const text = button?.dataset["copies"];
  if (text) void copy(text);
});

/** Copies to the clipboard; if the browser denies it, shows the text to be copied by hand. */
async function copy(text: string): Promise<void> {
  try {
    await putOnClipboard(text);
    toast("Copied.");
  } catch {
    toast(text, SHOWN_MS);
  }
}
