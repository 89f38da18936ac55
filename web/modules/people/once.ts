// A secret that is shown once: put on the page by the module that got it, gone when the reader has it or leaves.

import "../dataset/copy_buttons.js";

/** Shows the secret in the page's place for it, under the title. */
export function showOnce(secret: string, title: string): void {
  const place = document.querySelector<HTMLElement>("[data-once]");
  const code = place?.querySelector("[data-secret]");
  const copies = place?.querySelector<HTMLElement>("[data-copies]");
  const heading = place?.querySelector("h2");
  if (!place || !code || !copies || !heading) return;
  heading.textContent = title;
  code.textContent = secret;
  copies.dataset["copies"] = secret;
  place.hidden = false;
  place.focus();
}

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element ? event.target.closest("[data-forget]") : null;
  const place = button?.closest<HTMLElement>("[data-once]");
  if (!place) return;
  place.hidden = true;
  place.querySelector("[data-secret]")?.replaceChildren();
  place.querySelector<HTMLElement>("[data-copies]")?.removeAttribute("data-copies");
});
