// The worker: decompresses and decodes data, builds faces, and finds the voxel that a ray meets.

import { decompress } from "../../../libraries/fzstd/esm/index.mjs";
import { messageOf } from "../../errors.js";
import type { CameraView, Frustum, ViewSize } from "./camera_views.js";
import { type Cloud, camerasOf, cloudOf, planesOf, radarOf, surfaceOf, tileOf, type Surface } from "./formats.js";
import type { Grid } from "./grid.js";
import type { Look } from "../looks.js";
import { type Drawn, Model, type Picked, type Ray } from "./model.js";
import type { Piece, Pose, SceneFacts } from "../scene.js";

export type Asked =
  | { kind: "open"; scene: SceneFacts }
  | { kind: "frame"; token: string; content: Uint8Array | null; look: Look }
  | { kind: "second"; content: Uint8Array; grid: Grid; look: Look }
  | { kind: "tile"; piece: Piece; content: Uint8Array | null }
  | { kind: "draw-tile"; name: string; look: Look; level: number }
  | { kind: "mesh"; content: Uint8Array }
  | { kind: "cloud"; content: Uint8Array }
  | { kind: "radar"; content: Uint8Array }
  | { kind: "cameras"; content: Uint8Array }
  | { kind: "camera-views"; token: string; look: Look; sizes: ViewSize[] }
  | { kind: "frusta"; token: string }
  | { kind: "pick-voxel"; token: string; voxel: number; look: Look }
  | { kind: "pick"; ray: Ray; scope: "frame" | "map"; token: string; look: Look };

export interface Answers {
  open: null;
  frame: Drawn;
  /** A frame of another label set, by class. */
  second: Drawn;
  tile: null;
  "draw-tile": Drawn;
  mesh: Surface;
  cloud: Cloud;
  radar: Cloud;
  /** Whether there is a picture, by camera and frame. */
  cameras: { frames: number; hasPicture: Uint8Array };
  "camera-views": CameraView[];
  frusta: Frustum[];
  "pick-voxel": Picked;
  pick: Picked | null;
}

const NOWHERE: Pose = [0, 0, 0, 1, 0, 0, 0];
let model: Model | null = null;

addEventListener("message", (event: MessageEvent<Asked & { id: number }>) => {
  answer(event.data);
});

function answer(asked: Asked & { id: number }): void {
  try {
    const value = answerTo(asked);
    postMessage({ id: asked.id, value }, { transfer: buffersOf(value) });
  } catch (error) {
    postMessage({ id: asked.id, error: messageOf(error) });
  }
}

function answerTo(asked: Asked): Answers[Asked["kind"]] {
  if (asked.kind === "open") {
    model = new Model(asked.scene);
    return null;
  }
  if (!model) throw new Error("The scene was not opened.");
  switch (asked.kind) {
    case "frame":
      if (asked.content) model.keepFrame(asked.token, asked.look.mode, planesOf(decompress(asked.content), model.scene.grid, magicOf(asked.look)));
      return model.drawFrame(asked.token, asked.look);
    case "second":
      return model.drawPlanes(planesOf(decompress(asked.content), asked.grid), { ...asked.look, mode: "class" }, NOWHERE);
    case "tile":
      if (asked.content) model.tiles.keep(asked.piece, tileOf(decompress(asked.content)));
      return null;
    case "draw-tile":
      return model.drawTile(asked.name, asked.look, asked.level);
    case "mesh":
      return surfaceOf(decompress(asked.content));
    case "cloud":
      return cloudOf(decompress(asked.content));
    case "radar":
      return radarOf(decompress(asked.content));
    case "cameras": {
      const facts = camerasOf(decompress(asked.content));
      model.openCameras(facts);
      return { frames: facts.frames, hasPicture: facts.hasPicture.slice() };
    }
    case "camera-views":
      return model.cameraViews(asked.token, asked.look, asked.sizes);
    case "frusta":
      return model.frusta(asked.token);
    case "pick-voxel":
      return model.pickedAt(asked.token, asked.voxel, asked.look);
    case "pick":
      return model.pick(asked.ray, asked.scope, asked.token, asked.look);
  }
}

function magicOf(look: Look): "STV1" | "STD1" {
  return look.mode === "difference" ? "STD1" : "STV1";
}

function buffersOf(value: Answers[Asked["kind"]]): Transferable[] {
  if (value === null) return [];
  if (Array.isArray(value)) return value.flatMap((one) => ("ids" in one ? [one.ids.buffer, one.colours.buffer] : []));
  if ("faces" in value) return [value.faces.vertices.buffer, value.faces.indices.buffer, ...(value.lowest ? [value.lowest.buffer] : [])];
  if ("triangles" in value) return [value.vertices_m.buffer, value.classes.buffer, value.triangles.buffer];
  if ("points_cm" in value) return [value.points_cm.buffer, value.intensity.buffer];
  return [];
}
