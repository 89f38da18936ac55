// Dialogs: `data-opens="id"` opens a dialog, `data-closes` closes it; Escape and the backdrop close it too.

export function installDialogs(): void {
  document.addEventListener("click", (event) => {
    if (!(event.target instanceof Element)) return;
    const opens = event.target.closest<HTMLElement>("[data-opens]");
    if (opens) {
      const dialog = document.getElementById(opens.dataset["opens"] ?? "");
      if (dialog instanceof HTMLDialogElement) dialog.showModal();
      return;
    }
    if (event.target.closest("[data-closes]")) event.target.closest("dialog")?.close();
    else if (event.target instanceof HTMLDialogElement) event.target.close(); // its backdrop
  });
}
