// Runs before everything else, as a classic script. It sets the theme, so that no page flashes in the other one.
//
// It also records a quick reader's submits and clicks until the modules are loaded. Otherwise the browser itself would
// send our forms, with their fields in the URL.
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
