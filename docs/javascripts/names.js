// A dialog has a name, which Material's search has not; and what scrolls by itself is reached by keyboard.
const SCROLLING = ".md-typeset__scrollwrap, .md-typeset__table, .md-typeset pre > code, .md-typeset .highlight";

function complete() {
  for (const dialog of document.querySelectorAll("[role=dialog]:not([aria-label])")) dialog.setAttribute("aria-label", "Search");
  for (const region of document.querySelectorAll(SCROLLING)) region.tabIndex = 0;
}

new MutationObserver(complete).observe(document.body, { childList: true, subtree: true }); // tables are wrapped later
complete();
