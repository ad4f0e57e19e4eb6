// Pixels of the picture per pixel of the page: fewer during movements on a slow device.

/** Maximum ratio; more is hardly visible. */
const MOST = 2;
/**
 * Frame intervals in milliseconds: above the first, a device is slow; below the second, it can draw
 * four times the pixels.
 */
const [SLOW, QUICK] = [45, 12];
/** Milliseconds after the last frame of a movement at which the full picture is drawn. */
const REST = 200;
const COARSE = 0.5;

export class Resolution {
  /** Pixels per pixel of the page. */
  ratio = 1;
  /** True if the current frame must be drawn fast rather than well. */
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
   * `software` begins with coarse pictures and draws pictures at rest larger instead of
   * antialiasing.
   *
   * `settled` is called after a movement has ended.
   */
  constructor(software: boolean, settled: () => void) {
    this.#slow = software;
    this.#larger = software ? 1.5 : 1;
    this.#settled = settled;
  }

  /** Reports a change: the movement continues, however long its next frame takes. */
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
