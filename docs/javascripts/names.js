// A dialog has a name, which Material's search has not; a screen reader says it.
for (const dialog of document.querySelectorAll("[role=dialog]:not([aria-label])")) {
  dialog.setAttribute("aria-label", "Search");
}
