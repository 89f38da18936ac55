// Light or dark before the first paint: a classic script, so that no page flashes in the other theme.
{
  const chosen = localStorage.getItem("stone-theme");
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset["theme"] = chosen;
}
