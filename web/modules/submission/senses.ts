// The sensors of a method: boxes for cameras, LiDAR and radar; the API uses their combination.

const MISSING = "Select at least one modality.";

export function installSenses(form: HTMLFormElement): void {
  const told = (): void => boxes(form)[0]?.setCustomValidity(modalityOf(form) ? "" : MISSING);
  for (const box of boxes(form)) box.addEventListener("change", told);
  told();
}

/** `C+L`; empty while nothing is chosen. */
export function modalityOf(form: HTMLFormElement): string {
  return boxes(form).filter((box) => box.checked).map((box) => box.value).join("+");
}

export function sayModality(form: HTMLFormElement, modality: string): void {
  const letters = modality.split("+");
  for (const box of boxes(form)) box.checked = letters.includes(box.value);
  boxes(form)[0]?.dispatchEvent(new Event("change"));
}

function boxes(form: HTMLFormElement): HTMLInputElement[] {
  return [...form.querySelectorAll<HTMLInputElement>("[name=sense]")];
}
