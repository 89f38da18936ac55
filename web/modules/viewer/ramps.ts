// Ramps of colour with even lightness: viridis for measures, its upper three quarters for confidence and points,
// inferno for D² (Smith and van der Walt, 2015). In the lowest quarter, doubtful voxels would look like holes on a dark
// page, and weak points would be invisible.
//
// Polynomials of degree six fitted to the published tables (M. Zucker), rows by power, columns red, green, blue.

export type Rgb = readonly [number, number, number];

const VIRIDIS: Rgb[] = [
  [0.27773, 0.00541, 0.3341],
  [0.10509, 1.40461, 1.38459],
  [-0.33086, 0.21485, 0.0951],
  [-4.63423, -5.7991, -19.33244],
  [6.22827, 14.17993, 56.69055],
  [4.77638, -13.74515, -65.35303],
  [-5.43546, 4.64585, 26.31244],
];
const INFERNO: Rgb[] = [
  [0.00022, 0.00165, -0.01948],
  [0.10651, 0.56396, 3.93271],
  [11.60249, -3.97285, -15.94239],
  [-41.704, 17.4364, 44.35415],
  [77.16294, -33.40236, -81.80731],
  [-71.31942, 32.62606, 73.20952],
  [25.13112, -12.24267, -23.07033],
];

/** Each ramp's table, and its start and length within it. */
const RAMPS = { viridis: [VIRIDIS, 0, 1], lighter: [VIRIDIS, 0.25, 0.75], inferno: [INFERNO, 0.15, 0.8] } as const;
export type RampName = keyof typeof RAMPS;

/** The colour at `share` 0–1 as 0–255 each. */
export function ramp(name: RampName, share: number): [number, number, number] {
  const [rows, begin, length] = RAMPS[name];
  const at = begin + length * share;
  const channel = (c: 0 | 1 | 2): number => {
    const value = rows.reduceRight((sum, row) => sum * at + row[c], 0);
    return Math.round(255 * Math.min(1, Math.max(0, value)));
  };
  return [channel(0), channel(1), channel(2)];
}
