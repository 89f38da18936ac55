// The own account: a new token's secret is shown once; a new password is typed twice.

import { showOnce } from "./once.js";

interface Issued {
  name?: string; // tokens have a name, webhooks none
  secret: string;
}

document.addEventListener("acted", (event) => {
  const form = event.target;
  if (!(form instanceof HTMLFormElement) || !form.hasAttribute("data-issues") || !(event instanceof CustomEvent)) return;
  const issued = event.detail as Issued;
  form.reset();
  form.closest("dialog")?.close(); // first, so that the focus moves to the secret
  document.querySelector("[data-of-tokens]")?.toggleAttribute("hidden", issued.name === undefined);
  showOnce(issued.secret, issued.name === undefined ? "Your webhook's secret" : `Your new token: ${issued.name}`);
});

for (const again of document.querySelectorAll<HTMLInputElement>("[data-again]")) {
  const first = again.form?.elements.namedItem(again.dataset["again"] ?? "");
  const compare = (): void => {
    const isSame = first instanceof HTMLInputElement && first.value === again.value;
    again.setCustomValidity(isSame ? "" : "The passwords do not match.");
  };
  again.form?.addEventListener("input", compare);
}

for (const boxes of document.querySelectorAll("[data-issues] .may-choices")) {
  const all = [...boxes.querySelectorAll<HTMLInputElement>('input[type="checkbox"]')];
  const check = (): void => all[0]?.setCustomValidity(all.some((box) => box.checked) ? "" : "Select at least one scope.");
  boxes.addEventListener("change", check);
}
