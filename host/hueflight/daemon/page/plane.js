// SPDX-License-Identifier: Apache-2.0
// The flat views: depth, colour, each band, photons.
//
// They are drawn in two dimensions, without WebGL: a picture has so few pixels that colouring them takes a
// fraction of a millisecond, whereas WebGL without a graphics processor colours every pixel of the screen.

import { colourMap, wavelengthColour } from "./colours.js";
import { fit } from "./gl.js";
import { shade, shadeFlags, tonesOf } from "./shading.js";

const BACKGROUND = "#0d0f12";
const HATCHING = "rgb(255 92 77 / 0.75)";
const STRIPE = 3; // width of the stripes of the hatching, in CSS pixels
const GAP = 2; // between the tiles of the bands, in pixels of the screen

export class Plane {
  #canvas;
  #context;
  #picture = null;
  #image = new Raster();
  #flagged = new Raster();
  #map;
  #tones = new Map(); // of each wavelength

  constructor(canvas) {
    this.#canvas = canvas;
    this.#context = canvas.getContext("2d", { alpha: false });
    this.chooseMap("viridis");
  }

  /** Use another colour map, by its name. */
  chooseMap(name) {
    this.#map = new Uint32Array(colourMap(name).buffer);
  }

  /** Take a picture, to be drawn next time. */
  show(picture) {
    this.#picture = picture;
  }

  /** Tiles of the band view: [x, y, width, height] as shares of the canvas. */
  static tiles(count) {
    const across = Math.ceil(Math.sqrt(count));
    const down = Math.ceil(count / across);
    return Array.from({ length: count }, (_, i) => [
      (i % across) / across, Math.floor(i / across) / down, 1 / across, 1 / down,
    ]);
  }

  /**
   * Draw the picture; see `shade` for the options, but `limit` is in metres here. `flags` are bits of
   * quality whose pixels are hatched.
   */
  draw({ bands, limit, flags, ...options }) {
    const picture = this.#picture;
    if (!picture) {
      this.#clear();
      return;
    }
    const { view } = options;
    const shades = { ...options, map: this.#map, limit: limit / picture.depth_std_scale };
    const hatched = flags && picture.planes.quality && view !== "photons";
    if (view === "bands") this.#drawBands(bands, shades, hatched ? flags : 0);
    else if (hatched) this.#drawHatched(shades, flags);
    else this.#drawAsItIs(shades);
  }

  #clear() {
    this.#context.fillStyle = BACKGROUND;
    this.#context.fillRect(0, 0, this.#canvas.width, this.#canvas.height);
  }

  /** Draw with as many pixels as the picture has; the browser enlarges them. */
  #drawAsItIs(shades) {
    const { rows, cols } = this.#picture;
    const canvas = this.#canvas;
    if (canvas.width !== cols || canvas.height !== rows) [canvas.width, canvas.height] = [cols, rows];
    this.#paint(shades);
    this.#context.putImageData(this.#image.data, 0, 0);
  }

  #drawHatched(shades, flags) {
    fit(this.#canvas);
    this.#paint(shades);
    this.#hatch(flags);
    const { width, height } = this.#canvas;
    this.#place([0, 0, width, height], true);
  }

  #drawBands(bands, shades, flags) {
    fit(this.#canvas);
    this.#clear();
    const { width, height } = this.#canvas;
    if (flags) this.#hatch(flags);
    Plane.tiles(bands.length).forEach(([x, y, w, h], band) => {
      const [left, top] = [Math.round(x * width), Math.round(y * height)];
      const [right, bottom] = [Math.round((x + w) * width), Math.round((y + h) * height)];
      this.#paint({ ...shades, band, tones: this.#tonesOf(bands[band].wavelength_nm) });
      this.#place([left, top, right - left - GAP, bottom - top - GAP], Boolean(flags));
    });
  }

  #tonesOf(nm) {
    if (!this.#tones.has(nm)) this.#tones.set(nm, tonesOf(wavelengthColour(nm)));
    return this.#tones.get(nm);
  }

  #paint(shades) {
    const { rows, cols } = this.#picture;
    shade(this.#image.pixels(rows, cols), this.#picture, shades);
  }

  #hatch(flags) {
    const { rows, cols, planes } = this.#picture;
    shadeFlags(this.#flagged.pixels(rows, cols), planes.quality, flags);
  }

  /** Enlarge the image, and the hatching over it, to a rectangle [left, top, width, height] of the canvas. */
  #place(rectangle, hatched) {
    const c = this.#context;
    c.imageSmoothingEnabled = false;
    c.drawImage(this.#image.canvas(), ...rectangle);
    if (hatched) c.drawImage(this.#hatching(rectangle), rectangle[0], rectangle[1]);
  }

  /** The flagged pixels, enlarged, in stripes. */
  #hatching([, , width, height]) {
    const made = new OffscreenCanvas(width, height);
    const c = made.getContext("2d");
    c.imageSmoothingEnabled = false;
    c.drawImage(this.#flagged.canvas(), 0, 0, width, height);
    c.globalCompositeOperation = "source-in";
    c.strokeStyle = HATCHING;
    const stripe = STRIPE * (window.devicePixelRatio || 1);
    c.lineWidth = stripe * Math.SQRT1_2;
    c.beginPath();
    for (let x = stripe / 2; x < width + height; x += 2 * stripe) {
      c.moveTo(x - height, 0);
      c.lineTo(x, height);
    }
    c.stroke();
    return made;
  }
}

/** Pixels in memory that can be drawn, kept from picture to picture. */
class Raster {
  data = null;
  #canvas = null;

  /** The pixels as numbers, see `pack`, to be written. */
  pixels(rows, cols) {
    if (this.data?.width !== cols || this.data.height !== rows) {
      this.data = new ImageData(cols, rows);
      this.#canvas = new OffscreenCanvas(cols, rows);
    }
    return new Uint32Array(this.data.data.buffer);
  }

  /** The pixels as a canvas. */
  canvas() {
    this.#canvas.getContext("2d").putImageData(this.data, 0, 0);
    return this.#canvas;
  }
}
