/** The noise of shear, from the changes between frames: the service tells that of pressure only. @module */

const FRAMES = 64; // whose changes count
const MIN_FRAMES = 16; // before which the noise is not known
const QUANTILE = 0.25; // of the frames' changes, as a load that moves changes more than noise does
const MEDIAN_OVER_MEAN = Math.LN2; // of the square of a noisy vector's length
const MAX_GAP_S = 1; // between two frames that are compared

export class ShearNoise {
  constructor() {
    this._previous = new Float32Array(0);
    this._squares = new Float32Array(0);
    this._sorted = new Float32Array(FRAMES);
    this._changes = new Float32Array(FRAMES);
    this._timestamp = NaN;
    this._count = 0; // of changes
    /** Standard deviation of a taxel's shear, x and y together, counts; 0 where it is not known. */
    this.deviation = 0;
  }

  /** Forget what was seen. */
  reset() {
    this._timestamp = NaN;
    this._count = this.deviation = 0;
  }

  /**
   * Follow a frame.
   * @param {Float32Array} shear counts along x of all taxels, then along y; NaN where nothing is known
   * @param {number} timestamp Unix s
   */
  follow(shear, timestamp) {
    const elapsed = timestamp - this._timestamp;
    const comparable = elapsed > 0 && elapsed < MAX_GAP_S && shear.length === this._previous.length;
    this._timestamp = timestamp;
    if (comparable) this._compare(shear);
    else if (this._previous.length !== shear.length) {
      this._previous = new Float32Array(shear.length);
      this._squares = new Float32Array(shear.length / 2);
    }
    this._previous.set(shear);
  }

  /** @param {Float32Array} shear */
  _compare(shear) {
    const { _previous: previous, _squares: squares } = this;
    const count = squares.length;
    let known = 0;
    for (let i = 0; i < count; i += 1) {
      const square = (shear[i] - previous[i]) ** 2 + (shear[count + i] - previous[count + i]) ** 2;
      squares[i] = Number.isNaN(square) ? Infinity : square;
      if (squares[i] < Infinity) known += 1;
    }
    if (!known) return;
    squares.sort();
    this._changes[this._count % FRAMES] = squares[known >> 1];
    this._count += 1;
    if (this._count < MIN_FRAMES) return;
    this._sorted.fill(Infinity).set(this._changes.subarray(0, this._count));
    this._sorted.sort();
    const square = this._sorted[Math.floor(QUANTILE * Math.min(FRAMES, this._count))];
    this.deviation = Math.sqrt(square / (2 * MEDIAN_OVER_MEAN)); // a change has the noise of two frames
  }
}
