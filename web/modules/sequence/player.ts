// The clock of a timeline: frames follow each other at the robot's pace, times a speed.

/** Plays through frames at `times_s`; `show` is called for each that is due and resolves once it is seen. */
export class Player {
  private isOn = false;
  private started_ms = 0;
  private from_s = 0;
  speed = 1;

  constructor(
    private readonly times_s: readonly number[],
    private readonly show: (index: number) => Promise<void>,
    private readonly told: (isOn: boolean) => void,
  ) {}

  get isPlaying(): boolean {
    return this.isOn;
  }

  /** Plays from this frame; from the last frame, from the start. */
  play(index: number): void {
    const from = index >= this.times_s.length - 1 ? 0 : index;
    this.isOn = true;
    this.told(true);
    this.restart(from);
    void this.run(from);
  }

  pause(): void {
    if (!this.isOn) return;
    this.isOn = false;
    this.told(false);
  }

  /** From now on, count from this frame. */
  restart(index: number): void {
    this.from_s = this.times_s[index] ?? 0;
    this.started_ms = performance.now();
  }

  private async run(from: number): Promise<void> {
    let index = from;
    while (this.isOn && index < this.times_s.length - 1) {
      const now_s = this.from_s + ((performance.now() - this.started_ms) / 1000) * this.speed;
      const due = this.dueAt(now_s, index);
      if (due > index) {
        index = due;
        await this.show(index);
      } else await nextPaint();
    }
    this.pause();
  }

  /** The last frame that has started by then. */
  private dueAt(now_s: number, index: number): number {
    let due = index;
    while (due + 1 < this.times_s.length && (this.times_s[due + 1] ?? Infinity) <= now_s) due += 1;
    return due;
  }
}

function nextPaint(): Promise<number> {
  return new Promise((resolve) => requestAnimationFrame(resolve));
}
