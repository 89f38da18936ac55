// Before anything else, as a classic script: the theme, so that no page flashes in the other one; and what a quick reader
// does before the modules are there, which is done as soon as they are. Without it a form of ours would be sent the
// browser's own way, its fields in the address.
{
  const chosen = localStorage.getItem("stone-theme");
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset["theme"] = chosen;

  const kept: (() => void)[] = [];
  const keep = (event: Event, again: () => void): void => {
    event.preventDefault();
    event.stopImmediatePropagation();
    kept.push(again);
  };
  const submitted = (event: SubmitEvent): void => {
    const form = event.target;
    if (form instanceof HTMLFormElement && !form.hasAttribute("method")) keep(event, () => form.requestSubmit(event.submitter));
  };
  const clicked = (event: Event): void => {
    const button = event.target instanceof Element ? event.target.closest<HTMLButtonElement>('button[type="button"]') : null;
    if (button) keep(event, () => button.click());
  };
  document.addEventListener("submit", submitted, true);
  document.addEventListener("click", clicked, true);
  document.addEventListener("DOMContentLoaded", () => {
    document.removeEventListener("submit", submitted, true);
    document.removeEventListener("click", clicked, true);
    for (const again of kept) again();
  });
}
