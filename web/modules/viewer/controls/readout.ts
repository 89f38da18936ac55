// Describes a selected voxel: its class, its values, and the reason of its class.

import { fixed } from "../../counts.js";
import { swatch } from "./choices.js";
import { make } from "./elements.js";
import { CLASS_NAMES, reason, valuesOf } from "./explanation.js";
import { DIFFERENCES } from "../looks.js";
import type { Picked } from "../data/model.js";
import type { SceneFacts, Vector } from "../scene.js";

const DIFFERENCE_FILLS = ["", "fill-same", "fill-only-a", "fill-only-b", "fill-easier", "fill-harder"] as const;
const FILLS = ["fill-unseen", "fill-t", "fill-p", "fill-n"] as const;

export class Readout {
  readonly element = make("section", { class: "viewer-readout card", "aria-label": "Selected voxel", "aria-live": "polite", hidden: true });

  constructor(private readonly scene: SceneFacts, private readonly closed: () => void) {}

  say(picked: Picked | null): void {
    this.element.hidden = picked === null;
    if (picked === null) return void this.element.replaceChildren();
    const close = make("button", { type: "button", class: "quiet small", "aria-label": "Close" }, "×");
    close.addEventListener("click", this.closed);
    const title = titleOf(picked);
    this.element.replaceChildren(
      make("div", { class: "row between" }, title, close),
      ...(picked.difference === null ? [make("p", {}, reason(picked, this.scene))] : []),
      make("dl", { class: "facts" }, ...this.rows(picked).flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)])),
    );
  }

  private rows({ found, centre_m, centre_ego_m, voxel }: Picked): [string, string][] {
    return [
      ...(found ? valuesOf(found, this.scene) : []),
      ["Voxel of the frame", voxel ? `[${voxel.join(", ")}]` : "outside its grid"],
      ["Ego position", placed(centre_ego_m)],
      ["Map position", placed(centre_m)],
    ];
  }
}

function placed(point_m: Vector): string {
  return `${point_m.map((value) => fixed(value, 1)).join(", ")} m`;
}

function titleOf({ kind, difference }: Picked): HTMLElement {
  if (difference !== null) return make("h3", {}, swatch(DIFFERENCE_FILLS[difference] ?? "fill-unseen"), DIFFERENCES[difference] ?? "");
  return make("h3", {}, swatch(FILLS[kind]!), CLASS_NAMES[kind]!);
}
