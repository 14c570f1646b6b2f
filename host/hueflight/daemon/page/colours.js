// Colours: the map for depth, what a wavelength looks like, which bands stand for red, green, blue.

// Thirty-three of the 256 colours of viridis (S. van der Walt and N. Smith, 2015, public domain),
// the same as in exported previews.
const NODES =
  "440154470d6048186a482374472d7b4537814240863e49893b528b375b8d33638d" +
  "2f6b8e2c728e297a8e26828e23898e21918c1f988b1fa08822a78528ae8032b67a" +
  "3fbc734ec36b5ec96270cf5784d44b98d83eaddc30c2df23d8e219ece51bfde725";

/** The map as 256 RGBA colours. */
export function colourMap() {
  const nodes = NODES.match(/../g).map((pair) => parseInt(pair, 16));
  const last = nodes.length / 3 - 1;
  const out = new Uint8Array(256 * 4);
  for (let i = 0; i < 256; i++) {
    const place = (i / 255) * last;
    const low = Math.min(Math.floor(place), last - 1);
    const share = place - low;
    for (let c = 0; c < 3; c++) {
      out[4 * i + c] = Math.round(nodes[3 * low + c] * (1 - share) + nodes[3 * low + 3 + c] * share);
    }
    out[4 * i + 3] = 255;
  }
  return out;
}

const ANCHORS = [400, 420, 445, 470, 498, 525, 570, 597, 623, 645, 680];
const TABLES = [
  [0.42, 0.45, 0.22, 0.05, 0.0, 0.1, 0.7, 0.95, 0.93, 0.85, 0.6],
  [0.1, 0.15, 0.3, 0.45, 0.65, 0.65, 0.7, 0.65, 0.38, 0.15, 0.08],
  [0.7, 0.8, 0.88, 0.9, 0.7, 0.2, 0.05, 0.05, 0.1, 0.12, 0.1],
];

/** A colour, [r, g, b] in 0..1, that reminds of a wavelength; grey outside the visible. */
export function wavelengthColour(nm) {
  if (nm < 380 || nm > 720) return [0.45, 0.45, 0.45];
  const at = Math.max(0, Math.min(ANCHORS.length - 2, ANCHORS.findLastIndex((a) => a <= nm)));
  const share = Math.max(0, Math.min(1, (nm - ANCHORS[at]) / (ANCHORS[at + 1] - ANCHORS[at])));
  return TABLES.map((t) => t[at] * (1 - share) + t[at + 1] * share);
}

/** The same as CSS, with opacity. */
export function wavelengthCss(nm, opacity = 1) {
  const [r, g, b] = wavelengthColour(nm).map((v) => Math.round(255 * v));
  return `rgb(${r} ${g} ${b} / ${opacity})`;
}

/** Indices of the bands nearest to the paper's red, green and blue (Fig. 4j). */
export function rgbBands(bands) {
  return [623, 525, 445].map((wanted) => {
    const away = bands.map((band) => Math.abs(band.wavelength_nm - wanted));
    return away.indexOf(Math.min(...away));
  });
}
