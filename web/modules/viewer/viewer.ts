// The viewer of one sequence: stage, timeline, panel and readout, put together.

import { Aiming } from "./controls/pointer.js";
import { type Choices, choicesPanel, firstChoices } from "./controls/choices.js";
import { button, make } from "./controls/elements.js";
import { keysPanel } from "./controls/keys.js";
import { classLegend, differenceLegend, rampLegend } from "./controls/legend.js";
import type { Ray } from "./data/model.js";
import { Readout } from "./controls/readout.js";
import type { SceneFacts } from "./scene.js";
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
  /** The frame is kept in the page's address. */
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
  private readonly follows: HTMLButtonElement;
  private counts: readonly number[] = [0, 0, 0];

  constructor(private readonly host: HTMLElement, private readonly scene: SceneFacts, private readonly options: Options) {
    const canvas = make("canvas", {
      class: "viewer-canvas", tabindex: "0", role: "application", "aria-roledescription": "3D view",
      "aria-label": `Labels of ${scene.name} in 3D. Arrows turn, plus and minus near, comma and full stop step, space plays, c aims.`,
    });
    this.frameIn(canvas);
    this.choices = firstChoices(scene);
    this.stage = new Stage(canvas);
    this.stage.orbit.isShy = options.isCompact;
    this.world = new World(scene, this.stage, this.choices);
    this.readout = new Readout(scene, () => this.drop());
    this.aiming = new Aiming(this.stage, this.world.origin, (ray) => void this.pick(ray));
    this.timeline = new Timeline(scene.frames.stamps_ns.map(BigInt), (index) => this.show(index));
    this.follows = button("Follow the robot", FOLLOW, () => this.follow());
    this.follows.setAttribute("aria-pressed", "true");
    this.furnish(canvas.parentElement!);
    canvas.addEventListener("webglcontextlost", () => this.say("The graphics card let go of the picture. It comes back by itself, or load the page again."));
    canvas.addEventListener("webglcontextrestored", () => (this.say(null), this.stage.ask()));
    host.addEventListener("keydown", (event) => this.key(event));
    host.addEventListener("show-frame", (event) => this.asked(event as CustomEvent<{ index?: number; token?: string }>));
  }

  async open(): Promise<void> {
    this.world.look("behind");
    await this.world.open();
    this.world.index = this.options.start;
    this.world.look("behind");
    await this.show(this.options.start);
    this.stage.draw();
    performance.mark("first-voxel");
  }

  /** Shows the frame and says so; a refusal is said in the picture. */
  async show(index: number): Promise<void> {
    this.host.setAttribute("aria-busy", "true");
    try {
      const counts = await this.world.show(index);
      if (counts === null) return;
      this.counts = counts;
      this.stand(index);
    } catch (error) {
      this.say(isAbort(error) ? null : `Frame ${index + 1} cannot be shown: ${words(error)}`);
    } finally {
      this.host.removeAttribute("aria-busy");
    }
  }

  end(): void {
    this.timeline.pause();
    this.world.end();
    this.stage.end();
  }

  private stand(index: number): void {
    const token = this.scene.frames.tokens[index]!;
    this.say(null);
    this.timeline.stand(index);
    this.drawLegend();
    if (this.aiming.isOn) this.aiming.again();
    else this.readout.say(null);
    this.host.dataset["frame"] = String(index);
    this.host.dispatchEvent(new CustomEvent("frame", { bubbles: true, detail: { index, token } }));
    if (this.options.isAddressed) {
      const address = new URL(location.href);
      address.searchParams.set("frame", token);
      history.replaceState(null, "", address);
    }
  }

  private async changed(): Promise<void> {
    this.world.relook();
    this.drawLegend();
    try {
      await this.show(this.world.index);
      await this.world.choose();
    } catch (error) {
      this.say(words(error));
    }
  }

  private drawLegend(): void {
    const { look: { mode }, scope } = this.choices;
    const counts = scope === "frame" ? this.counts : [];
    if (mode === "difference") this.legend.replaceChildren(differenceLegend(counts));
    else this.legend.replaceChildren(mode === "class" ? classLegend(counts) : rampLegend(mode, this.scene));
  }

  private async pick(ray: Ray): Promise<void> {
    const picked = await this.world.pick(ray).catch(() => null);
    this.world.mark(picked);
    this.readout.say(picked);
    if (!picked && this.aiming.isOn) this.say("No voxel there.");
    else this.say(null);
  }

  private drop(): void {
    this.aiming.toggle(false);
    this.readout.say(null);
    this.world.mark(null);
    this.stage.canvas.focus();
  }

  private follow(): void {
    this.choices.follows = !this.choices.follows;
    this.follows.setAttribute("aria-pressed", String(this.choices.follows));
    if (this.choices.follows) this.world.look("behind");
  }

  private key(event: KeyboardEvent): void {
    const isTyping = event.target instanceof HTMLElement && event.target.closest("input, select, textarea, a, button, summary");
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
    const acts: Record<string, () => void> = {
      " ": () => this.timeline.toggle(),
      ",": () => this.timeline.step(-1),
      ".": () => this.timeline.step(1),
      "<": () => this.timeline.step(-10),
      ">": () => this.timeline.step(10),
      Home: () => this.timeline.seek(0),
      End: () => this.timeline.seek(Infinity),
      c: () => this.aiming.toggle(),
      Escape: () => this.drop(),
      f: () => this.follow(),
      "1": () => this.world.look("behind"),
      "2": () => this.world.look("above"),
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
    tools.append(
      this.follows,
      button("Behind the robot (1)", BEHIND, () => this.world.look("behind")),
      button("From above (2)", ABOVE, () => this.world.look("above")),
      button("Pick by keys (c)", AIM, () => (this.aiming.toggle(), this.stage.canvas.focus())),
      ...(document.fullscreenEnabled ? [button("Full screen", FULL, () => void toggleFull(this.host))] : []),
    );
    stage.append(this.legend, tools, this.aiming.crosshair, this.readout.element, this.said);
    this.host.append(this.timeline.element);
    if (this.options.isCompact) return;
    const panel = make("aside", { class: "viewer-panel", "aria-label": "What is shown" });
    panel.append(choicesPanel(this.scene, this.choices, () => void this.changed()), keysPanel());
    this.host.append(panel);
  }
}

function toggleFull(host: HTMLElement): Promise<void> {
  return document.fullscreenElement ? document.exitFullscreen() : host.requestFullscreen();
}

function isAbort(error: unknown): boolean {
  return error instanceof DOMException && error.name === "AbortError";
}

function words(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
