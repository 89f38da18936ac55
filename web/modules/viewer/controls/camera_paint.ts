// The labels that a camera sees, painted over its picture, and the picked voxel marked in it.

import type { CameraView } from "../data/camera_views.js";
import type { Rgb, Theme } from "../drawing/theme.js";

const ALPHA = 115;
/** A voxel with fewer pixels than this (of a view of 320 × 200) gets a ring, so that it is visible. */
const SMALL_RATIO = 30 / (320 * 200);
const RING_RATIO = 14 / 320;

/** Paints the view: colours of the palette, half transparent; the voxel `marked` solid with a rim. */
export function paintView(canvas: HTMLCanvasElement, view: CameraView, palette: Uint8Array, theme: Theme, marked: number): void {
  const { width, height, colours } = view;
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const context = canvas.getContext("2d", { willReadFrequently: true }); // painted by the processor
  if (!context) return;
  const drawn = new ImageData(width, height);
  const words = new Uint32Array(drawn.data.buffer);
  const inks = new Uint32Array(palette.slice().buffer).map((word) => (word & 0xffffff) | (ALPHA << 24));
  inks[0] = 0;
  for (let pixel = 0; pixel < words.length; pixel++) words[pixel] = inks[colours[pixel]!]!;
  const middle = marked ? markIn(words, view, marked, theme) : null;
  context.putImageData(drawn, 0, 0);
  canvas.dataset["marked"] = String(middle?.pixels ?? 0);
  if (middle && middle.pixels < SMALL_RATIO * width * height) ring(context, middle, width, theme);
}

interface MarkedPlace {
  x: number;
  y: number;
  pixels: number;
}

/** Draws the voxel's pixels in ink and those around it in the sheet's colour; returns its place, null if it is not
 * visible. */
function markIn(words: Uint32Array, { ids, width, height }: CameraView, id: number, theme: Theme): MarkedPlace | null {
  const [ink, rim] = [solid(theme.ink), solid(theme.sheet)];
  const place = { x: 0, y: 0, pixels: 0 };
  for (let at = ids.indexOf(id); at >= 0; at = ids.indexOf(id, at + 1)) {
    const [x, y] = [at % width, Math.floor(at / width)];
    place.x += x;
    place.y += y;
    place.pixels++;
    words[at] = ink;
    for (const [dx, dy] of [[-1, 0], [1, 0], [0, -1], [0, 1]] as const) {
      const isInside = x + dx >= 0 && x + dx < width && y + dy >= 0 && y + dy < height;
      const beside = at + dx + dy * width;
      if (isInside && ids[beside] !== id) words[beside] = rim;
    }
  }
  if (!place.pixels) return null;
  return { x: place.x / place.pixels + 0.5, y: place.y / place.pixels + 0.5, pixels: place.pixels };
}

function ring(context: CanvasRenderingContext2D, { x, y }: MarkedPlace, width: number, theme: Theme): void {
  const unit = width / 320;
  for (const [colour, thick] of [[theme.sheet, 5], [theme.ink, 2.5]] as const) {
    context.beginPath();
    context.arc(x, y, RING_RATIO * width, 0, 2 * Math.PI);
    context.lineWidth = thick * unit;
    context.strokeStyle = `rgb(${colour.join(" ")})`;
    context.stroke();
  }
}

function solid([red, green, blue]: Rgb): number {
  return (red | (green << 8) | (blue << 16) | (255 << 24)) >>> 0;
}
