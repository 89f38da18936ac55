// While a version is published: that it is being worked on, for how long by now, and that leaving does not stop it.

const form = document.querySelector<HTMLFormElement>("[data-publishes]");
const place = form?.querySelector<HTMLElement>("[data-publishing]");
const elapsed = form?.querySelector("[data-elapsed]");

if (form && place) {
  let since_ms = 0;
  const watched = new MutationObserver(() => {
    const isBusy = form.getAttribute("aria-busy") === "true";
    if (isBusy === !place.hidden) return;
    place.hidden = !isBusy;
    since_ms = performance.now();
    if (isBusy) tick();
  });
  const tick = (): void => {
    if (place.hidden || !elapsed) return;
    elapsed.textContent = `${Math.round((performance.now() - since_ms) / 1000)} s elapsed; publishing continues if you leave.`;
    setTimeout(tick, 1000);
  };
  watched.observe(form, { attributeFilter: ["aria-busy"] });
}
