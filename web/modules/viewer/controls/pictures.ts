// For browsers that draw no 3D: the frames from above as pictures, with the same timeline.

import { withColours } from "../../colours.js";
import { make } from "./elements.js";
import type { SceneFacts } from "../scene.js";
import { Timeline } from "./timeline.js";

export async function showPictures(host: HTMLElement, scene: SceneFacts, start: number): Promise<void> {
  const { tokens } = scene.frames;
  const picture = make("img", { alt: "", width: "512", height: "512", class: "viewer-above", "data-coloured": "" });
  const show = async (index: number): Promise<void> => {
    picture.src = withColours(`/api/v1/frames/${tokens[index]}/bev.png`);
    picture.alt = `Labels around the robot from above, frame ${index + 1} of ${tokens.length}`;
    await picture.decode().catch(() => undefined);
    timeline.stand(index);
    host.dataset["frame"] = String(index);
    host.dispatchEvent(new CustomEvent("frame", { bubbles: true, detail: { index, token: tokens[index] } }));
  };
  const timeline = new Timeline(scene.frames.stamps_ns.map(BigInt), show);
  const sentence = make("p", { class: "viewer-message", role: "status" });
  sentence.textContent = "3D is not available in this browser (WebGL 2 is missing or disabled), so the labels are shown from above.";
  host.replaceChildren(make("div", { class: "viewer-scene" }, picture), timeline.element, sentence);
  await show(start);
}
