// Choosing two entries of a board to compare: a third choice replaces the first.

const MOST = 2;

export function installPicking(): void {
  const picked: HTMLInputElement[] = [];
  document.addEventListener("change", (event) => {
    const box = event.target;
    if (!(box instanceof HTMLInputElement) || box.name !== "entry") return;
    if (box.checked) picked.push(box);
    else picked.splice(picked.indexOf(box), 1);
    while (picked.length > MOST) {
      const first = picked.shift();
      if (first) first.checked = false;
    }
    tell(picked);
  });
  document.addEventListener("submit", (event) => {
    if (!(event.target instanceof HTMLFormElement) || event.target.id !== "comparing") return;
    if (new FormData(event.target).getAll("entry").length === MOST) return;
    event.preventDefault();
    say("Select two entries with the checkboxes on the left first.");
  });
}

function tell(picked: readonly HTMLInputElement[]): void {
  const names = picked.map((box) => box.closest("tr")?.querySelector(".method .row > :first-child")?.textContent ?? "");
  if (names.length === MOST) say(`${names[0]} against ${names[1]}`);
  else if (names.length === 1) say(`${names[0]} against …`);
  else say("Select two entries to test whether their difference is significant.");
}

function say(sentence: string): void {
  const place = document.querySelector("[data-picked]");
  if (place) place.textContent = sentence;
}
