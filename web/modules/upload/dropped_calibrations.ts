// Calibrations dropped together with bags: stored, and assigned to the sequences of those bags.

import { call } from "../api.js";
import { refresh } from "../refresh.js";
import { calibrationLine, type Kept, keep, reasonsOf, showKept } from "./calibration_file.js";
import { chooseCalibration } from "./facts.js";
import type { Found } from "./bags.js";

type Left = { name: string; why: string };

const MOST = 20;
const TOO_MANY = `Not read as a calibration, because more than ${MOST} such files were dropped. Drop the calibration alone.`;
const UNASSIGNED = "Not assigned: choose it under Calibration. ";

/** Their destination: the panel of one sequence, or the form with the metadata of all uploads. */
export interface Place {
  /** The list of lines. */
  lines: HTMLElement;
  sequenceId: string;
  /** Whether that sequence has a calibration, which is not replaced automatically. */
  isCalibrated: boolean;
  facts: HTMLFormElement | null;
}

/** Stores the calibrations among the files, and returns the others with the reason. One by one, because each costs the
 * platform time. */
export async function takeCalibrations(found: readonly Found[], place: Place): Promise<Left[]> {
  const left: Left[] = found.slice(MOST).map(({ path }) => ({ name: path, why: TOO_MANY }));
  const kept: { one: Kept; file: File; item: HTMLLIElement }[] = [];
  for (const { file, path } of found.slice(0, MOST)) {
    const item = calibrationLine(file);
    place.lines.append(item);
    try {
      kept.push({ one: await keep(file), file, item });
    } catch (error) {
      item.remove();
      const reasons = reasonsOf(error).map(({ code, sentence }) => `${code}: ${sentence}`);
      left.unshift({ name: path, why: `Not a valid calibration. ${reasons.join(" ")}` });
    }
  }
  const [only] = kept;
  const next = only !== undefined && kept.length === 1 ? await assigned(only.one, place) : UNASSIGNED;
  for (const { one, file, item } of kept) showKept(item, file, one, next);
  return left;
}

/** The result, in a sentence. */
async function assigned(kept: Kept, place: Place): Promise<string> {
  try {
    return (await used(kept, place)) ? "Assigned. " : UNASSIGNED;
  } catch (error) {
    const why = reasonsOf(error).map(({ sentence }) => sentence);
    return `Not assigned: ${why.join(" ")} `;
  }
}

/** Give it to the sequence, or choose it for all that come. */
async function used(kept: Kept, { sequenceId, isCalibrated, facts }: Place): Promise<boolean> {
  if (!sequenceId) return chooseCalibration(facts, kept);
  if (isCalibrated) return false;
  await call("PUT", `/api/v1/sequences/${sequenceId}/calibration`, { calibration_id: kept.id });
  for (const part of ["#calibration", "#process"]) if (document.querySelector(part)) await refresh(part).catch(() => undefined); // it is assigned all the same
  return true;
}
