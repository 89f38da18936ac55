// The rules' verdicts, requested from the API after every move; only the response to the last request is shown.

import { call } from "../api.js";
import { messageOf } from "../errors.js";
import { listsOf } from "./arrangement.js";
import type { Board } from "./board.js";
import type { EditorState } from "./editor_state.js";

const PAUSE_MS = 150;

export interface Finding {
  code: string;
  severity: "error" | "warning";
  message: string;
  sequence_ids: string[];
}

interface Answer {
  revision: number;
  can_be_put: boolean;
  findings: Finding[];
  gap: { message: string } | null;
}

type Tone = "waiting" | "good" | "warning" | "error";

const SAID: Readonly<Record<Tone, string>> = { waiting: "", good: ": satisfied", warning: ": as far as the data allow", error: ": violated" };

export class Verdicts {
  private asked = 0;
  private timer = 0;
  private findings: readonly Finding[] = [];
  private isEmpty = true;
  private chosen = "";
  /** Whether the platform would accept the splits. */
  canBePut = false;

  constructor(
    private readonly root: HTMLElement,
    private readonly state: EditorState,
    private readonly board: Board,
    private readonly told: (revision: number) => void,
  ) {
    state.onChange(() => this.ask());
    root.addEventListener("click", (event) => this.click(event));
    void this.answer();
  }

  private ask(): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.answer(), PAUSE_MS);
  }

  private async answer(): Promise<void> {
    const number = ++this.asked;
    try {
      const answer = await call<Answer>("POST", "/api/v1/splits/verdicts", listsOf(this.state.current));
      if (number === this.asked) this.show(answer);
    } catch (error) {
      if (number === this.asked) this.say("waiting", `The rules could not be checked: ${messageOf(error)}`);
    }
  }

  private show(answer: Answer): void {
    this.findings = answer.findings;
    this.canBePut = answer.can_be_put;
    const errors = answer.findings.filter((one) => one.severity === "error");
    const broken = new Set(errors.map((one) => one.code)).size;
    this.isEmpty = Object.values(listsOf(this.state.current)).every((ids) => !ids.length);
    if (broken) this.say("error", broken === 1 ? "One rule is violated" : `${broken} rules are violated`);
    else if (this.isEmpty) this.say("warning", "No sequence is in a split yet");
    else if (answer.findings.length) this.say("warning", `All rules met where the data permit (${answer.findings.length} ${answer.findings.length === 1 ? "warning" : "warnings"})`);
    else this.say("good", "All rules satisfied");
    for (const rule of this.root.querySelectorAll<HTMLElement>("[data-rule]")) this.showRule(rule);
    this.showGap(answer.gap?.message ?? "");
    this.list();
    this.told(answer.revision);
  }

  private showGap(message: string): void {
    const gap = this.root.querySelector<HTMLElement>("[data-gap]");
    if (!gap) return;
    gap.hidden = !message;
    gap.textContent = `${message.charAt(0).toUpperCase()}${message.slice(1)}.`;
  }

  private showRule(rule: HTMLElement): void {
    const of = this.findings.filter((one) => one.code === rule.dataset["rule"]);
    const tone: Tone = of.some((one) => one.severity === "error") ? "error" : of.length ? "warning" : this.isEmpty ? "waiting" : "good";
    rule.dataset["tone"] = tone;
    const says = rule.querySelector("[data-rule-says]");
    if (says) says.textContent = SAID[tone];
  }

  /** Always lists errors; lists warnings only for the chosen rule. */
  private list(): void {
    const shown = this.findings.filter((one) => (this.chosen ? one.code === this.chosen : one.severity === "error"));
    const place = this.root.querySelector<HTMLElement>("[data-findings]");
    place?.replaceChildren(...shown.map(asItem));
    if (place) place.hidden = !shown.length;
    for (const rule of this.root.querySelectorAll<HTMLElement>("[data-rule]")) {
      rule.setAttribute("aria-expanded", String(rule.dataset["rule"] === this.chosen && shown.length > 0));
    }
    const listed = this.chosen ? shown : [];
    this.board.mark(new Set(listed.flatMap((one) => one.sequence_ids)));
  }

  private click(event: MouseEvent): void {
    if (!(event.target instanceof Element)) return;
    const rule = event.target.closest<HTMLElement>("[data-rule]");
    const finding = event.target.closest<HTMLElement>("[data-finding]");
    if (rule) {
      this.chosen = this.chosen === rule.dataset["rule"] ? "" : (rule.dataset["rule"] ?? "");
      this.list();
    } else if (finding) this.board.mark(new Set(finding.dataset["finding"]?.split(" ")));
  }

  private say(tone: Tone, sentence: string): void {
    const verdict = this.root.querySelector<HTMLElement>("[data-verdict]");
    if (!verdict) return;
    verdict.dataset["tone"] = tone;
    verdict.textContent = sentence;
  }
}

/** The finding with a button that shows which sequences it is about. */
export function asItem(finding: Finding): HTMLLIElement {
  const item = Object.assign(document.createElement("li"), { className: "finding" });
  item.dataset["severity"] = finding.severity;
  item.append(Object.assign(document.createElement("span"), { textContent: `${finding.message}.` }));
  if (finding.sequence_ids.length) {
    const show = Object.assign(document.createElement("button"), { type: "button", className: "small quiet", textContent: "Show" });
    show.dataset["finding"] = finding.sequence_ids.join(" ");
    item.append(show);
  }
  return item;
}
