// Common behaviour of all pages: forms that act, parts that refresh, dialogs, times, the theme.

import { installActs } from "./acts.js";
import { installColours } from "./colours.js";
import { installDialogs } from "./dialogs.js";
import { installMoments } from "./moments.js";
import { installRefreshing } from "./refresh.js";
import { installTimes } from "./times.js";

installActs();
installColours();
installDialogs();
installMoments();
installRefreshing();
installTimes();

document.querySelector("[data-theme-switch]")?.addEventListener("click", () => {
  const root = document.documentElement;
  const isDark = root.dataset["theme"]
    ? root.dataset["theme"] === "dark"
    : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset["theme"] = isDark ? "light" : "dark";
  localStorage.setItem("stone-theme", root.dataset["theme"]);
});
