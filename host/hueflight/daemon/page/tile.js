// SPDX-License-Identifier: Apache-2.0
// One camera among several: its live picture, its state, and its rates.

import { rgbBands } from "./colours.js";
import { big, stateOf } from "./facts.js";
import { live } from "./link.js";
import { decodePicture } from "./message.js";
import { Plane } from "./plane.js";
import { spanOf } from "./ranges.js";
import { brightnessOf, depthOf } from "./values.js";

const INTERVAL_MS = 100; // from picture to picture of a tile, so that many fit on one page
const VALUES = { depth: depthOf, photons: brightnessOf };

export class Tile {
  #plane = null;
  #picture = null;
  #instrument = null;
  #status = null;
  #connected = false;
  #view;

  /** A tile of the daemon's camera `number`, of which 0 is its own; `view` gives the view that is chosen. */
  constructor(number, address, view) {
    this.#view = view;
    this.element = document.createElement("article");
    this.element.className = "tile";
    this.element.dataset.number = number;
    this.element.innerHTML = `<header><h2><a></a></h2><p class="pill"></p><p class="pill recording" hidden></p></header>
      <div class="view"><canvas></canvas><p class="watermark" hidden>simulated</p><p class="stale"></p></div>
      <p class="note"></p>`;
    const link = this.#find("a");
    link.href = address ? `//${address}/` : "./";
    link.textContent = address || "this camera";
    this.#plane = new Plane(this.#find("canvas"));
    let shownMs = 0;
    live({
      path: number ? `/api/cameras/${number}/live` : "/api/live",
      onPicture: (message, answerShown) => {
        this.#picture = decodePicture(message);
        this.#plane.show(this.#picture);
        this.redraw();
        const wait = Math.max(0, INTERVAL_MS - (performance.now() - shownMs));
        shownMs = performance.now() + wait;
        setTimeout(() => answerShown(0), wait); // a tile says nothing of latency
      },
      onStatus: (status) => {
        this.#status = status;
        link.textContent = status.name;
        this.#show();
      },
      onOpen: () => {
        this.#connected = true;
        this.#show();
      },
      onClose: () => {
        this.#connected = false;
        this.#show();
      },
    });
    this.#show();
  }

  /** Use what is known of the camera. */
  use({ instrument }) {
    if (!instrument || this.#instrument) return;
    this.#instrument = instrument;
    const { rows, cols, pixel_aspect } = instrument;
    this.#find(".view").style.aspectRatio = `${cols} / ${rows * pixel_aspect}`;
    this.redraw();
  }

  /** Draw the picture in the view that is chosen; photons where there is no calibration. */
  redraw() {
    const picture = this.#picture;
    if (!picture || !this.#instrument) return;
    const view = picture.planes.depth ? this.#view() : "photons";
    const { bands } = this.#instrument;
    const range = view === "colour" ? [0, 1] : spanOf(picture, VALUES[view]);
    this.#plane.draw({
      view, bands, rgb: rgbBands(bands), three: !picture.planes.colours,
      range: view === "depth" ? range.map((v) => v / picture.depth_scale) : range,
      logarithmic: false, limit: 0, flags: 0,
    });
  }

  #show() {
    const { text, kind } = stateOf(this.#status, this.#connected);
    const [pill, recording] = this.element.querySelectorAll(".pill");
    pill.textContent = text;
    pill.className = `pill ${kind}`;
    const shown = this.#connected && this.#status;
    recording.hidden = !(shown && shown.recording.name);
    recording.textContent = shown ? shown.recording.name : "";
    this.#find(".watermark").hidden = !shown?.simulated;
    const old = !shown || shown.picture.stale;
    this.#find(".view").classList.toggle("old", old);
    this.#find(".stale").textContent = !shown ? "Not reachable." : shown.state === "idle" ? "Stopped." : old ? "No new picture." : "";
    if (!shown) return;
    const lost = Object.values(shown.lost).reduce((sum, n) => sum + n, 0);
    this.#find(".note").textContent = [
      `${big(shown.rates.frames)} frames/s`, `${big(shown.rates.photons)} photons/s`,
      lost ? `${lost.toLocaleString("en")} frames lost` : "none lost", shown.problem,
    ].filter(Boolean).join(" · ");
  }

  #find(selector) {
    return this.element.querySelector(selector);
  }
}
