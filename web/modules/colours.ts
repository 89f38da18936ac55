// The class colours that a reader chose: stored in a cookie for the next pages, and applied to this page at once.

const COOKIE = "stone_colours";
const PARAMETER = "colours";
const DEFAULT = "default";

/** The switch in the footer; pictures of labels are marked with `data-coloured`. */
export function installColours(): void {
  const choice = document.querySelector<HTMLSelectElement>("[data-colours-switch]");
  if (!choice) return;
  choice.value = chosen(); // browsers restore form values on reload
  choice.addEventListener("change", () => {
    document.cookie = `${COOKIE}=${choice.value}; Path=/; Max-Age=31536000; SameSite=Lax`;
    if (choice.value === DEFAULT) delete document.documentElement.dataset["colours"];
    else document.documentElement.dataset["colours"] = choice.value;
    for (const picture of document.querySelectorAll<HTMLImageElement>("img[data-coloured]")) {
      picture.src = withColours(picture.getAttribute("src") ?? "");
    }
    document.dispatchEvent(new Event("colours"));
  });
}

/** The address of a picture of labels in the colours that were chosen. */
export function withColours(address: string): string {
  const url = new URL(address, location.href);
  url.searchParams.delete(PARAMETER);
  if (chosen() !== DEFAULT) url.searchParams.set(PARAMETER, chosen());
  return url.origin === location.origin ? url.pathname + url.search : url.href;
}

function chosen(): string {
  return document.documentElement.dataset["colours"] ?? DEFAULT;
}
