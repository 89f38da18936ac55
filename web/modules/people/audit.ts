// The audit log: the platform verifies the whole chain and reports whether each line follows from the previous one.

import "../dataset/copy_buttons.js";
import { call } from "../api.js";
import { messageOf } from "../errors.js";

interface Verification {
  is_whole: boolean;
  first_broken: number | null;
  lines: number;
  head_hash: string;
}

const chain = document.querySelector<HTMLElement>("[data-chain]");
if (chain) {
  chain.querySelector("[data-verify]")?.addEventListener("click", () => void verify(chain));
  void verify(chain);
}

async function verify(chain: HTMLElement): Promise<void> {
  const again = chain.querySelector<HTMLButtonElement>("[data-verify]");
  if (again) again.disabled = true;
  say(chain, "waiting", "Verifying the hash chain…", "");
  try {
    const found = await call<Verification>("GET", "/api/v1/admin/audit-log/verification");
    const lines = found.lines === 1 ? "1 line" : `${found.lines.toLocaleString("en")} lines`;
    if (found.is_whole) say(chain, "good", "The log is intact", `${lines} verified.`);
    else say(chain, "error", `The log is broken at line ${found.first_broken ?? 0}`, "That entry, or one before it, was changed or removed.");
    showHead(chain, found.head_hash);
  } catch (error) {
    say(chain, "error", "The log could not be verified", messageOf(error));
  } finally {
    if (again) again.disabled = false;
  }
}

function say(chain: HTMLElement, tone: string, sentence: string, more: string): void {
  const said = chain.querySelector<HTMLElement>("[data-chain-said]");
  const lines = chain.querySelector("[data-chain-lines]");
  if (said) said.dataset["tone"] = tone;
  said?.replaceChildren(sentence);
  lines?.replaceChildren(more);
}

function showHead(chain: HTMLElement, hash: string): void {
  chain.querySelector("[data-chain-hash]")?.replaceChildren(hash || "none yet");
  const copy = chain.querySelector<HTMLButtonElement>("[data-chain-copy]");
  if (!copy) return;
  copy.dataset["copies"] = hash;
  copy.disabled = !hash;
}
