// Pixels of the picture for each of the page: fewer while it moves on a slow device.

/** More than this is hardly seen. */
const MOST = 2;
/** Milliseconds between frames above which a device is slow; below the other, four times the pixels are no burden. */
const [SLOW, QUICK] = [45, 12];
/** Milliseconds after the last frame of a movement at which the picture is drawn in full. */
const REST = 200;
const COARSE = 0.5;

export class Resolution {
  /** Pixels for each of the page. */
  ratio = 1;
  /** Whether the present frame is to be drawn quickly rather than well. */
  coarse = false;
  readonly #larger: number;
  readonly #settled: () => void;
  #slow: boolean;
  #resting = false;
  #last = 0;
  /** Mean of the latest intervals between frames of a movement, milliseconds. */
  #interval = 0;
  #timer: ReturnType<typeof setTimeout> | undefined;

  /**
   * `software` begins coarsely, and draws a picture at rest larger in place of antialiasing; `settled` is called when a
   * movement has ended.
   */
  constructor(software: boolean, settled: () => void) {
    this.#slow = software;
    this.#larger = software ? 1.5 : 1;
    this.#settled = settled;
  }

  /** Something has changed, so the movement goes on, however long its next frame takes. */
  moved(): void {
    clearTimeout(this.#timer);
    this.#resting = false;
  }

  /** Chooses the ratio of a frame. */
  frame(now: number): void {
    const interval = now - this.#last;
    this.#last = now;
    clearTimeout(this.#timer);
    if (this.#resting) {
      this.#resting = false;
      this.coarse = false;
      this.ratio = Math.min(devicePixelRatio * this.#larger, MOST);
      return;
    }
    if (interval < REST) {
      this.#interval += (interval - this.#interval) * 0.3;
      if (this.#interval > SLOW) this.#slow = true;
      else if (this.#interval < QUICK) this.#slow = false;
    } else this.#interval = (SLOW + QUICK) / 2;
    this.coarse = this.#slow;
    this.ratio = Math.min(devicePixelRatio, MOST) * (this.coarse ? COARSE : 1);
    this.#timer = setTimeout(this.#rest, REST);
  }

  dispose(): void {
    clearTimeout(this.#timer);
  }

  readonly #rest = (): void => {
    this.#resting = true;
    this.#settled();
  };
}
