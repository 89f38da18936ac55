// Buttons that copy: `data-copies` is the text.

import { toast } from "../said.js";

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element ? event.target.closest<HTMLElement>("[data-copies]") : null;
  const text = button?.dataset["copies"];
  if (!text) return;
  navigator.clipboard.writeText(text).then(
    () => toast("Copied."),
    () => toast(text, 20_000),
  );
});
