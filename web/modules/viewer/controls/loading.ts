// How much of the whole run is drawn.

import { make } from "./elements.js";

export class Loading {
  private readonly bar = make("progress", { "aria-label": "Tiles of the whole run" });
  private readonly words = make("span");
  readonly element = make("p", { class: "viewer-loading", hidden: true }, this.bar, this.words);

  tell(done: number, of: number): void {
    this.element.hidden = done >= of;
    [this.bar.value, this.bar.max] = [done, of];
    this.words.textContent = `Whole run: ${done} of ${of} tiles`;
  }
}
