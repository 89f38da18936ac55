// The viewer of one sequence: combines stage, timeline, panel and readout.

import { call } from "../api.js";
import { messageOf } from "../errors.js";
import { Aiming } from "./controls/pointer.js";
import { Asking } from "./data/worker_client.js";
import { Address, type Begins, type Standing, read } from "./controls/address.js";
import { CameraPanel } from "./controls/camera_panel.js";
import { type Choices, choicesPanel, firstChoices, namedSet, secondField } from "./controls/choices.js";
import { button, make } from "./controls/elements.js";
import { isFree, keysPanel } from "./controls/keys.js";
import { classLegend, differenceLegend, pointLegend, radarLegend, rampLegend, secondLegend } from "./controls/legend.js";
import { CLASS_NAMES } from "./controls/explanation.js";
import type { Picked, Ray } from "./data/model.js";
import { Loading } from "./controls/loading.js";
import { Readout } from "./controls/readout.js";
import { isShown, isWithin } from "./looks.js";
import type { LabelSetFacts, SceneFacts } from "./scene.js";
import { Stage } from "./drawing/stage.js";
import { Timeline } from "./controls/timeline.js";
import { World } from "./world.js";

const FOLLOW = "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zm9 3h-2.1A7 7 0 0 0 13 5.1V3h-2v2.1A7 7 0 0 0 5.1 11H3v2h2.1a7 7 0 0 0 5.9 5.9V21h2v-2.1a7 7 0 0 0 5.9-5.9H21z";
const BEHIND = "M4 18l8-12 8 12-8-3.6z";
const ABOVE = "M4 4h7v7H4zM13 4h7v7h-7zM4 13h7v7H4zM13 13h7v7h-7z";
const AIM = "M11 2h2v6h-2zM11 16h2v6h-2zM2 11h6v2H2zM16 11h6v2h-6z";
const FULL = "M4 4h6v2H6v4H4zM14 4h6v6h-2V6h-4zM4 14h2v4h4v2H4zM18 14h2v6h-6v-2h4z";

export interface Options {
  start: number;
  isCompact: boolean;
  /** Whether the page's URL contains the frame. */
  isAddressed: boolean;
}

export class Viewer {
  readonly stage: Stage;
  readonly timeline: Timeline;
  private readonly world: World;
  private readonly choices: Choices;
  private readonly readout: Readout;
  private readonly aiming: Aiming;
  private readonly legend = make("div", { class: "viewer-corner" });
  private readonly said = make("p", { class: "viewer-said", role: "status", hidden: true });
  private readonly loading = new Loading();
  private readonly follows: HTMLButtonElement;
  private readonly cameras: CameraPanel | null;
  private readonly address: Address;
  private readonly begins: Begins;
  private isMoved = false;
  private counts: readonly number[] = [0, 0, 0];
  private readonly ended = new AbortController();

  constructor(private readonly host: HTMLElement, private readonly scene: SceneFacts, private readonly options: Options) {
    const canvas = make("canvas", {
      class: "viewer-canvas", tabindex: "0", role: "application", "aria-roledescription": "3D view",
      "aria-label": `Labels of ${scene.name} in 3D. Arrow keys rotate, plus and minus zoom, comma and full stop step through frames, space plays, c shows the crosshair.`,
    });
    this.frameIn(canvas);
    this.choices = firstChoices(scene);
    this.begins = options.isAddressed ? read(new URL(location.href), scene, this.choices) : { enlarged: null, second: null, at: null };
    this.address = new Address(() => this.standing(), firstChoices(scene));
    this.stage = new Stage(canvas);
    this.stage.orbit.isShy = options.isCompact;
    this.world = new World(scene, new Asking(), this.stage, this.choices);
    this.world.tiled = (done, of) => this.loading.tell(done, of);
    this.world.clouded = () => this.drawLegend();
    this.readout = new Readout(scene, () => this.drop());
    this.aiming = new Aiming(this.stage, this.world.origin, (ray) => void this.pick(ray));
    this.timeline = new Timeline(scene.frames.stamps_ns.map(BigInt), (index) => this.show(index));
    this.follows = button("Follow the robot (f)", "Follow", FOLLOW, () => this.follow());
    this.follows.setAttribute("aria-pressed", String(this.choices.follows));
    this.stage.orbit.moved = () => this.moved(true);
    const acts = { picked: (id: number) => void this.pickVoxel(id), unknown: (why: string) => this.say(why), enlarged: () => this.note() };
    this.cameras = options.isCompact ? null : new CameraPanel(host, scene, this.stage, this.world.asking, this.choices, acts);
    this.furnish(canvas.parentElement!);
    canvas.addEventListener("webglcontextlost", () => this.say("The graphics context was lost. It is restored automatically; otherwise reload the page."));
    canvas.addEventListener("webglcontextrestored", () => (this.say(null), this.stage.ask()));
    const { signal } = this.ended;
    (options.isAddressed ? document : host).addEventListener("keydown", (event) => this.key(event as KeyboardEvent), { signal });
    host.addEventListener("show-frame", (event) => this.asked(event as CustomEvent<{ index?: number; token?: string }>));
  }

  async open(): Promise<void> {
    this.world.look("behind");
    await this.world.open();
    this.world.index = this.options.start;
    this.world.look("behind");
    if (this.begins.at) [this.world.viewpoint, this.isMoved] = [this.begins.at, true];
    await this.show(this.options.start);
    this.stage.draw();
    performance.mark("first-voxel");
    void this.offerSecond();
    await this.cameras?.open(this.options.start, this.begins.enlarged);
    if (this.choices.layers.sensors) await this.world.choose(); // the camera poses are now loaded
  }

  /** Shows the frame and updates its texts; a refusal is shown in the picture. */
  async show(index: number): Promise<void> {
    this.host.setAttribute("aria-busy", "true");
    try {
      const counts = await this.world.show(index, () => this.cameras?.take(index, this.timeline.isPlaying) ?? Promise.resolve());
      if (counts === null) return;
      this.counts = counts;
      this.cameras?.put(index);
      this.stand(index);
    } catch (error) {
      this.say(isAbort(error) ? null : `Frame ${index + 1} cannot be shown: ${messageOf(error)}`);
    } finally {
      this.host.removeAttribute("aria-busy");
    }
  }

  end(): void {
    this.ended.abort();
    this.timeline.pause();
    this.address.end();
    this.cameras?.end();
    this.world.end();
    this.stage.end();
  }

  private stand(index: number): void {
    const token = this.scene.frames.tokens[index]!;
    this.say(null);
    this.timeline.stand(index);
    this.drawLegend();
    if (this.aiming.isOn) this.aiming.again();
    else this.choose(null);
    this.host.dataset["frame"] = String(index);
    this.host.dispatchEvent(new CustomEvent("frame", { bubbles: true, detail: { index, token } }));
    this.note();
  }

  /** Offers the other label sets of the sequence to users who may see them. */
  private async offerSecond(): Promise<void> {
    const panel = this.host.querySelector(".viewer-choices fieldset");
    if (!panel || this.host.dataset["labelSets"] === undefined) return;
    const { sequence_id, label_set_id } = this.scene;
    try {
      const { items } = await call<{ items: LabelSetFacts[] }>("GET", `/api/v1/sequences/${sequence_id}/label-sets`);
      const others = items.filter((one) => one.id !== label_set_id);
      this.choices.second = others.find((one) => one.id === this.begins.second) ?? null;
      panel.append(secondField(others, this.choices, () => void this.changed()));
      if (this.choices.second) await this.changed();
    } catch (error) {
      this.say(`The other label sets cannot be listed: ${messageOf(error)}`);
    }
  }

  private standing(): Standing {
    const token = this.scene.frames.tokens[this.world.index]!;
    const isAside = this.isMoved || !this.choices.follows; // a camera that follows nothing is left behind by the robot
    const at = isAside ? this.world.viewpoint : null;
    return { token, choices: this.choices, enlarged: this.cameras?.enlarged ?? null, at };
  }

  /** The address follows. */
  private note(): void {
    if (this.options.isAddressed) this.address.changed();
  }

  private moved(isMoved: boolean): void {
    this.isMoved = isMoved;
    this.note();
  }

  private look(from: "behind" | "above"): void {
    this.world.look(from);
    this.moved(from !== "behind");
  }

  private async changed(): Promise<void> {
    this.world.relook();
    this.drawLegend();
    try {
      await this.show(this.world.index);
      await this.world.choose();
    } catch (error) {
      this.say(messageOf(error));
    }
    this.note();
  }

  /** How points are drawn changed. */
  private dressed(): void {
    this.world.dressPoints();
    this.drawLegend();
    this.note();
  }

  private drawLegend(): void {
    const { look: { mode }, scope, layers, points, second } = this.choices;
    const counts = scope === "frame" ? this.counts : [];
    if (mode === "difference") this.legend.replaceChildren(differenceLegend(counts));
    else this.legend.replaceChildren(mode === "class" ? classLegend(counts) : rampLegend(mode, this.scene));
    if (second && scope === "frame" && mode !== "difference") this.legend.append(secondLegend(namedSet(second)));
    if (layers.radar) this.legend.append(radarLegend());
    if (layers.points) this.legend.append(pointLegend(points, this.world.pointRange));
  }

  private async pick(ray: Ray): Promise<void> {
    const picked = await this.world.pick(ray).catch(() => null);
    this.choose(picked);
    if (!picked && this.aiming.isOn) this.say("No voxel there.");
    else this.say(null);
  }

  /** Selects the voxel at the clicked pixel of a picture. */
  private async pickVoxel(id: number): Promise<void> {
    this.aiming.toggle(false);
    const picked = id ? await this.world.pickVoxel(id).catch(() => null) : null;
    this.choose(picked);
    if (!picked) this.say("No label there: free, or outside the label grid.");
    else if (picked.difference === null && !isShown(this.choices.look, picked.kind, picked.seen)) {
      this.say(`Switched off: ${CLASS_NAMES[picked.kind]}${picked.seen ? "" : ", not observed"}.`);
    } else if (!isWithin(this.choices.look.heights_m, picked.centre_ego_m[2])) this.say("Not among the heights that are shown.");
    else this.say(null);
  }

  /** Explained, and marked in 3D and in the pictures. */
  private choose(picked: Picked | null): void {
    this.world.mark(picked);
    this.readout.say(picked);
    this.cameras?.mark(picked?.id ?? 0);
  }

  private drop(): void {
    this.aiming.toggle(false);
    this.choose(null);
    this.stage.canvas.focus();
  }

  /** Closes the large picture; else the crosshair and the selection. */
  private leave(): void {
    if (this.cameras?.enlarged) this.cameras.enlarge(null);
    else if (this.aiming.isOn || !this.readout.element.hidden) this.drop();
  }

  private follow(): void {
    this.choices.follows = !this.choices.follows;
    this.follows.setAttribute("aria-pressed", String(this.choices.follows));
    if (this.choices.follows) this.look("behind");
    this.note();
  }

  /** With labels, without, hidden, in turn. */
  private turnCameras(): void {
    const select = this.host.querySelector<HTMLSelectElement>("[data-chooses=cameras]");
    if (!select || select.disabled) return;
    select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
    select.dispatchEvent(new Event("change"));
  }

  private key(event: KeyboardEvent): void {
    if (!isFree(event, this.host)) return;
    const acts: Record<string, () => void> = {
      " ": () => this.timeline.toggle(),
      ",": () => this.timeline.step(-1),
      ".": () => this.timeline.step(1),
      "<": () => this.timeline.step(-10),
      ">": () => this.timeline.step(10),
      Home: () => this.timeline.seek(0),
      End: () => this.timeline.seek(Infinity),
      c: () => this.aiming.toggle(),
      Escape: () => this.leave(),
      f: () => this.follow(),
      v: () => this.turnCameras(),
      "1": () => this.look("behind"),
      "2": () => this.look("above"),
    };
    const act = acts[event.key];
    act?.();
    if (act || this.aiming.key(event) || this.stage.orbit.key(event)) event.preventDefault();
  }

  private asked({ detail }: CustomEvent<{ index?: number; token?: string }>): void {
    const index = detail.index ?? this.scene.frames.tokens.indexOf(detail.token ?? "");
    if (index >= 0 && index !== this.world.index) this.timeline.seek(index);
  }

  private say(sentence: string | null): void {
    this.said.hidden = sentence === null;
    this.said.textContent = sentence ?? "";
  }

  private frameIn(canvas: HTMLCanvasElement): void {
    this.host.append(make("div", { class: "viewer-scene" }, canvas));
  }

  private furnish(stage: HTMLElement): void {
    const tools = make("div", { class: "viewer-tools", role: "toolbar", "aria-label": "Camera" });
    const menu = button("Views", "Views", ABOVE, () => undefined);
    menu.classList.add("viewer-menu");
    tools.addEventListener("click", (event) => {
      const isOpen = menu.contains(event.target as Node) && menu.getAttribute("aria-expanded") !== "true"; // a choice closes it
      menu.setAttribute("aria-expanded", String(isOpen));
    });
    menu.setAttribute("aria-expanded", "false");
    tools.append(
      menu,
      this.follows,
      button("Behind the robot (1)", "Behind", BEHIND, () => this.look("behind")),
      button("From above (2)", "Above", ABOVE, () => this.look("above")),
      button("Crosshair (c)", "Crosshair", AIM, () => (this.aiming.toggle(), this.stage.canvas.focus())),
      ...(document.fullscreenEnabled ? [button("Full screen", "Full screen", FULL, () => void toggleFull(this.host))] : []),
    );
    stage.append(this.legend, tools, this.aiming.crosshair, this.readout.element, this.said, this.loading.element);
    if (this.cameras) this.host.append(this.cameras.strip.large, this.cameras.strip.element);
    this.host.append(this.timeline.element);
    if (this.options.isCompact) return;
    const panel = make("aside", { class: "viewer-panel", "aria-label": "What is shown" });
    panel.append(choicesPanel(this.scene, this.choices, () => void this.changed(), () => this.dressed()), keysPanel());
    this.host.append(panel);
  }
}

function toggleFull(host: HTMLElement): Promise<void> {
  return document.fullscreenElement ? document.exitFullscreen() : host.requestFullscreen();
}

function isAbort(error: unknown): boolean {
  return error instanceof DOMException && error.name === "AbortError";
}
