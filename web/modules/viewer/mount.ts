// Viewers of a page: `<div data-viewer data-sequence="ID" data-start="first|middle|TOKEN" data-compact data-address
// data-comparison="ID" data-difference="ID" data-label-sets="COUNT" data-rig="FRONT_LEFT FRONT …" data-may-change>`.
//
// `comparison` is a comparison of two label sets whose differences are shown first, `difference` one whose differences
// are offered. With `label-sets` the reader may see the sequence's others; `rig` is the order of the cameras.
//
// The element's content (a picture, for example) is shown until the labels are loaded. The viewer is fetched when the
// element comes near the window. `data-state` is loading, ready, empty, picture (no WebGL2) or error. The element fires
// `frame` {index, token} for the shown frame and follows `show-frame` {index} or {token}.

import { RefusedError, call } from "../api.js";
import { messageOf } from "../errors.js";
import { make } from "./controls/elements.js";
import type { SceneFacts } from "./scene.js";
import type { Viewer } from "./viewer.js";

const NEAR_PX = "200px";
const viewers = new WeakMap<Element, Viewer>();

/** The viewer in this element, once it is ready. */
export function viewerOf(host: Element): Viewer | undefined {
  return viewers.get(host);
}

export function mountAll(root: ParentNode = document): void {
  const observer = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting || !(target instanceof HTMLElement)) continue;
      observer.unobserve(target);
      void mount(target);
    }
  }, { rootMargin: NEAR_PX });
  for (const host of root.querySelectorAll("[data-viewer]")) observer.observe(host);
}

export async function mount(host: HTMLElement): Promise<void> {
  host.classList.add("viewer");
  state(host, "loading");
  const poster = make("div", { class: "viewer-poster" }, ...host.childNodes);
  host.replaceChildren(poster);
  const draws = hasWebGl2();
  if (draws) void import("./viewer.js"); // on its way beside the scene
  try {
    const scene = await call<SceneFacts>("GET", `/api/v1/sequences/${host.dataset["sequence"]}/scene`);
    const compared = host.dataset["comparison"] ?? host.dataset["difference"];
    if (compared) scene.comparison_id = compared;
    scene.starts_with_difference = host.dataset["comparison"] !== undefined;
    await (scene.frames.tokens.length ? open(host, scene, draws) : say(host, "empty", "This run has no labelled frame."));
  } catch (error) {
    sayRefusal(host, error);
  }
  if (host.dataset["state"] === "ready") poster.remove();
}

async function open(host: HTMLElement, scene: SceneFacts, draws: boolean): Promise<void> {
  const start = startOf(host, scene);
  if (!draws) {
    const { showPictures } = await import("./controls/pictures.js");
    await showPictures(host, scene, start);
    return state(host, "picture");
  }
  const { Viewer } = await import("./viewer.js");
  const isCompact = host.dataset["compact"] !== undefined;
  const viewer = new Viewer(host, scene, { start, isCompact, isAddressed: host.dataset["address"] !== undefined });
  viewers.set(host, viewer);
  await viewer.open();
  state(host, "ready");
}

function startOf(host: HTMLElement, scene: SceneFacts): number {
  const { tokens } = scene.frames;
  const start = host.dataset["start"] ?? "first";
  if (start === "middle") return Math.floor(tokens.length / 2);
  return Math.max(0, tokens.indexOf(start));
}

function hasWebGl2(): boolean {
  return document.createElement("canvas").getContext("webgl2") !== null;
}

function sayRefusal(host: HTMLElement, error: unknown): void {
  const problem = error instanceof RefusedError ? error.problem : null;
  if (problem?.code === "no_scene") return say(host, "empty", problem.detail);
  if (problem?.status === 404) return say(host, "empty", "There are no labels yet. They appear here once the sequence has been processed.");
  say(host, "error", `The labels cannot be shown: ${messageOf(error)}`);
}

function say(host: HTMLElement, name: "empty" | "error", sentence: string): void {
  state(host, name);
  viewers.get(host)?.end();
  viewers.delete(host);
  for (const part of [...host.children]) if (!part.matches(".viewer-poster")) part.remove();
  host.append(make("p", { class: "viewer-message", role: name === "error" ? "alert" : "status" }, sentence));
}

function state(host: HTMLElement, name: "loading" | "ready" | "empty" | "picture" | "error"): void {
  host.dataset["state"] = name;
}

mountAll();
