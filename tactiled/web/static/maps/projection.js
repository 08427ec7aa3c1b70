/** An array seen from above at an angle, in parallel projection; its cells are columns, painted back to front. @module */

/** @import { Colormap } from "./colormap.js" */
/** @import { DisplayRange } from "./display_range.js" */
/** @import { Cells, Plane } from "./geometry.js" */

const [AZIMUTH_DEG, ELEVATION_DEG] = [-30, 35]; // at first
const MIN_ELEVATION_DEG = 10; // below, the front row hides the others
const HEIGHT_SHARE = 0.4; // of the array's diagonal, how high the range's top stands
const MARGIN_PX = { side: 40, top: 24, bottom: 24 }; // CSS px, for the texts of the axes
const EPSILON = 1e-6; // px, that columns overlap, so that rounding leaves no line between them

export class Projection {
  constructor() {
    /** @type {Pick<Plane, "left"|"top"|"width"|"height">} */
    this._plane = { left: 0, top: 0, width: 1, height: 1 };
    this._width = this._height = 1;
    this.cos = this.sin = this._left = this._top = this._x = this._y = NaN;
    /** Depth on the screen of one on the array. */
    this.flat = NaN;
    /** CSS px per mm, and of the range from its bottom to its top. */
    this.px = this.rise = NaN;
    /** Turn about the vertical, degrees; 0 with x to the right. */
    this.azimuth = AZIMUTH_DEG;
    /** Of the eye above the array, degrees; 90 as on a flat map. */
    this.elevation = ELEVATION_DEG;
    this._update();
  }

  /** Take the first view. */
  reset() {
    this.aim(AZIMUTH_DEG, ELEVATION_DEG);
  }

  /** @returns {boolean} it is another than the first view */
  get turned() {
    return this.azimuth !== AZIMUTH_DEG || this.elevation !== ELEVATION_DEG;
  }

  /** @param {number} right degrees that the front goes to the right @param {number} down degrees that it goes down */
  turn(right, down) {
    this.aim(this.azimuth - right, this.elevation + down);
  }

  /** @param {number} azimuth degrees @param {number} elevation degrees; the nearest that there is */
  aim(azimuth, elevation) {
    this.azimuth = ((((azimuth + 180) % 360) + 360) % 360) - 180;
    this.elevation = Math.max(MIN_ELEVATION_DEG, Math.min(90, elevation));
    this._update();
  }

  /**
   * Make the array as large as it can be turned in a box.
   * @param {Pick<Plane, "left"|"top"|"width"|"height">} plane
   * @param {number} width CSS px, of the box
   * @param {number} height
   */
  fit(plane, width, height) {
    [this._plane, this._width, this._height] = [plane, width, height];
    this._update();
  }

  _update() {
    const { _plane: plane, _width: width, _height: height } = this;
    const [azimuth, elevation] = [this.azimuth, this.elevation].map((each) => (each * Math.PI) / 180);
    const diagonal = Math.hypot(plane.width, plane.height);
    const upright = HEIGHT_SHARE * Math.cos(elevation);
    this.cos = Math.cos(azimuth);
    this.sin = Math.sin(azimuth);
    this.flat = Math.sin(elevation);
    const [wide, tall] = [width - 2 * MARGIN_PX.side, height - MARGIN_PX.top - MARGIN_PX.bottom];
    this.px = Math.max(0, Math.min(wide, tall / (this.flat + upright))) / diagonal;
    this.rise = this.px * diagonal * upright;
    this._left = width / 2;
    this._top = MARGIN_PX.top + (tall + this.rise) / 2;
    this._x = plane.left + plane.width / 2;
    this._y = plane.top + plane.height / 2;
  }

  /** @param {number} x mm @param {number} y mm @returns {number} CSS px from the box's left */
  left(x, y) {
    return this._left + ((x - this._x) * this.cos - (y - this._y) * this.sin) * this.px;
  }

  /** @param {number} x mm @param {number} y mm @param {number} share of the range @returns {number} CSS px from the box's top */
  top(x, y, share) {
    return this._top + ((x - this._x) * this.sin + (y - this._y) * this.cos) * this.px * this.flat - share * this.rise;
  }
}

/** The columns of cells in rows and columns. On the screen, all tops have the same outline: a parallelogram with one corner in front. */
export class Columns {
  /** @param {Cells} cells in rows and columns */
  constructor(cells) {
    this._cells = cells;
    this._heights = new Float64Array(cells.count); // px of the picture, as everything below; negative without data
    this._rise = NaN;
    /** Centre of the first cell, and the way from a cell to the next in its row and in its column. */
    this._x = this._y = this._alongX = this._alongY = this._downX = this._downY = NaN;
    /** Steps towards the eye, along a row and down a column. */
    this._dx = this._dy = 1;
    /** From its centre, the outline's corner in front and half of its width; slopes of its edges left and right of the corner. */
    this._cornerX = this._cornerY = this._half = this._slopeLeft = this._slopeRight = NaN;
  }

  /** @param {Projection} projection @param {number} ratio pixels of the picture per CSS px */
  aim(projection, ratio) {
    const { cos, sin, flat } = projection;
    const { x, y, side } = this._cells;
    const px = side * projection.px * ratio;
    this._x = projection.left(x[0], y[0]) * ratio;
    this._y = projection.top(x[0], y[0], 0) * ratio;
    this._rise = projection.rise * ratio;
    [this._alongX, this._alongY, this._downX, this._downY] = [cos * px, sin * flat * px, -sin * px, cos * flat * px];
    const [dx, dy] = [this._dx, this._dy] = [sin < 0 ? -1 : 1, cos < 0 ? -1 : 1];
    this._cornerX = (dx * this._alongX + dy * this._downX) / 2;
    this._cornerY = (dx * this._alongY + dy * this._downY) / 2;
    this._half = (dy * this._alongX - dx * this._downX) / 2;
    const rightY = (dy * this._alongY - dx * this._downY) / 2; // of the corner at the right; that at the left is opposite
    this._slopeLeft = (this._cornerY + rightY) / (this._cornerX + this._half || 1);
    this._slopeRight = (rightY - this._cornerY) / (this._half - this._cornerX || 1);
  }

  /**
   * @param {Uint32Array} pixels of the picture, transparent
   * @param {number} width of the picture
   * @param {Float32Array} values
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   * @param {Uint32Array[]} shades of its colours, of the sides left and right of the corner in front
   */
  paint(pixels, width, values, range, colormap, shades) {
    const { rows, columns } = this._cells;
    const { _heights: heights, _half: half, _cornerX: cornerX, _cornerY: cornerY, _dx: dx, _dy: dy } = this;
    for (let i = 0; i < heights.length; i += 1) {
      const share = (values[i] - range.low) / (range.high - range.low);
      heights[i] = share !== share ? -1 : Math.max(0, Math.min(1, share)) * this._rise;
    }
    for (let i = 0; i < rows; i += 1) {
      const row = dy > 0 ? i : rows - 1 - i;
      for (let j = 0; j < columns; j += 1) {
        const column = dx > 0 ? j : columns - 1 - j;
        const at = row * columns + column;
        const height = heights[at];
        if (height < 0) continue;
        const x = this._x + column * this._alongX + row * this._downX;
        const top = this._y + column * this._alongY + row * this._downY - height;
        // What a neighbour nearer to the eye hides of a side is not painted.
        const besideRow = height - (j + 1 < columns ? Math.max(0, heights[at + dx]) : 0);
        const besideColumn = height - (i + 1 < rows ? Math.max(0, heights[at + dy * columns]) : 0);
        const level = colormap.index(values[at], range);
        const last = Math.floor(x + half - 0.5);
        for (let k = Math.ceil(x - half - 0.5); k <= last; k += 1) {
          const right = k + 0.5 - x - cornerX;
          const left = k + 0.5 - x + cornerX; // of the corner behind
          const edge = top + cornerY + right * (right < 0 ? this._slopeLeft : this._slopeRight);
          const start = top - cornerY + left * (left > 0 ? this._slopeLeft : this._slopeRight);
          const side = (right < 0) === (dx * dy < 0) ? besideRow : besideColumn;
          const color = colormap.rgba[level];
          const edgeAt = Math.round(edge + EPSILON) * width + k;
          const endAt = Math.round(edge + side + EPSILON) * width + k;
          let p = Math.round(start - EPSILON) * width + k;
          for (; p < edgeAt; p += width) pixels[p] = color;
          const shade = shades[right < 0 ? 0 : 1][level];
          for (; p < endAt; p += width) pixels[p] = shade;
        }
      }
    }
  }
}
