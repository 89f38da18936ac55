// Along the drive: one slider moves the robot on the map and a cursor in every plot, and shows the values there.

import { nearest, onDrag, pageData, part, placeCursors } from "./parts.js";

interface Points {
  tokens: string[];
  times_s: number[];
  x_m: number[];
  y_m: number[];
  elevation_m: number[];
  speed_m_s: (number | null)[];
}

class TrackPage {
  private readonly points = pageData<Points>("track-points");
  private readonly slider: HTMLInputElement;
  private readonly robot: SVGCircleElement;

  constructor(private readonly root: HTMLElement) {
    this.slider = part<HTMLInputElement>(root, "[data-scrub]");
    this.robot = part<SVGCircleElement>(root, "[data-robot]");
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value)));
    const last_s = this.points.times_s.at(-1) ?? 0;
    for (const area of root.querySelectorAll(".plot-area")) {
      onDrag(area, (share) => this.show(nearest(this.points.times_s, share * last_s)));
    }
    const map = part<SVGSVGElement>(root, ".ground-map");
    map.addEventListener("pointerdown", (event) => this.show(this.nearestTo(map, event)));
    map.addEventListener("pointermove", (event) => event.buttons & 1 && this.show(this.nearestTo(map, event)));
  }

  private show(index: number): void {
    const { points } = this;
    const at_s = points.times_s[index] ?? 0;
    const speed = points.speed_m_s[index];
    const words = [`${at_s.toFixed(1)} s`, `${(points.elevation_m[index] ?? 0).toFixed(1)} m up`];
    if (speed !== null && speed !== undefined) words.splice(1, 0, `${speed.toFixed(1)} m/s`);
    this.slider.value = String(index);
    this.slider.setAttribute("aria-valuetext", words.join(", "));
    this.robot.setAttribute("cx", String(points.x_m[index] ?? 0));
    this.robot.setAttribute("cy", String(-(points.y_m[index] ?? 0)));
    this.robot.setAttribute("visibility", "visible");
    placeCursors(this.root, at_s / (points.times_s.at(-1) || 1));
    part(this.root, "[data-said]").textContent = words.join(" · ");
    part<HTMLAnchorElement>(this.root, "[data-frame-link]").href = `${this.root.dataset["framesAt"] ?? ""}?frame=${points.tokens[index] ?? ""}`;
  }

  /** The frame nearest to the pointer on the map. */
  private nearestTo(map: SVGSVGElement, event: PointerEvent): number {
    const screen = map.getScreenCTM();
    if (!screen) return 0;
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(screen.inverse());
    let found = 0;
    let least = Infinity;
    this.points.x_m.forEach((x_m, index) => {
      const away = (x_m - at.x) ** 2 + (-(this.points.y_m[index] ?? 0) - at.y) ** 2;
      if (away < least) [found, least] = [index, away];
    });
    return found;
  }
}

const root = document.querySelector<HTMLElement>("[data-track]");
if (root) new TrackPage(root);
