// SPDX-License-Identifier: Apache-2.0
// The points in space, each in the colour of its measured spectrum.

import { Textures, context, fit, program } from "./gl.js";

const VERTEX = `
uniform highp usampler2D depth, depth_std, quality;
uniform highp sampler2DArray bands;
uniform sampler2D colours;
uniform bool three;         // three bands as red, green and blue
uniform ivec3 rgb;
uniform ivec2 size;
uniform float unit;         // metres per step of depth
uniform vec2 slopes;        // metres right and down per metre of depth, at the last pixel
uniform float middle;       // depth that the view turns about
uniform mat4 camera;
uniform float dot;
uniform float limit;        // greatest standard deviation of depth, in units of its plane; 0 for any
uniform uint flags;         // bits of quality of pixels that are left out
out vec3 shade;
void main() {
  ivec2 at = ivec2(gl_VertexID % size.x, gl_VertexID / size.x);
  uint value = texelFetch(depth, at, 0).r;
  bool vague = limit > 0.0 && float(texelFetch(depth_std, at, 0).r) > limit;
  if (value == 65535u || vague || (texelFetch(quality, at, 0).r & flags) != 0u) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); gl_PointSize = 0.0; return; }
  float z = float(value) * unit;
  vec2 side = (vec2(at) / vec2(max(size - 1, 1)) * 2.0 - 1.0) * slopes * z;
  gl_Position = camera * vec4(side.x, -side.y, middle - z, 1.0);
  gl_PointSize = clamp(dot * z / gl_Position.w, 1.0, 24.0);
  shade = three ? vec3(
    texelFetch(bands, ivec3(at, rgb.r), 0).r, texelFetch(bands, ivec3(at, rgb.g), 0).r,
    texelFetch(bands, ivec3(at, rgb.b), 0).r) : texelFetch(colours, at, 0).rgb;
}`;

const FRAGMENT = `
in vec3 shade;
out vec4 colour;
void main() { colour = vec4(max(shade, vec3(0.06)), 1.0); }`;

const HOME = { turn: 0.45, tilt: 0.22, away: 1.0 };

export class Cloud {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = context(canvas);
    this.program = program(this.gl, VERTEX, FRAGMENT);
    this.textures = new Textures(this.gl);
    this.picture = null;
    this.middle = null;
    this.gl.bindVertexArray(this.gl.createVertexArray());
    this.home();
  }

  home() {
    Object.assign(this, HOME);
  }

  show(picture) {
    this.picture = picture;
    this.textures.fill(picture);
  }

  turnBy(turn, tilt) {
    this.turn = Math.max(-1.5, Math.min(1.5, this.turn + turn));
    this.tilt = Math.max(-1.4, Math.min(1.4, this.tilt + tilt));
  }

  zoomBy(factor) {
    this.away = Math.max(0.25, Math.min(4, this.away * factor));
  }

  draw({ rgb, three, range, slopes, limit, flags }) {
    fit(this.canvas);
    this.camera = null;
    const { gl, canvas, picture } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.05, 0.06, 0.07, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!picture?.planes.depth) return;
    const unit = picture.depth_scale;
    const middle = ((range[0] + range[1]) / 2) * unit;
    gl.useProgram(this.program.made);
    this.textures.use(this.program);
    const { uniforms } = this.program;
    gl.uniform1f(uniforms.limit, limit / picture.depth_std_scale);
    gl.uniform1ui(uniforms.flags, flags);
    gl.uniform3i(uniforms.rgb, ...rgb);
    gl.uniform1i(uniforms.three, three ? 1 : 0);
    gl.uniform2i(uniforms.size, picture.cols, picture.rows);
    gl.uniform1f(uniforms.unit, unit);
    gl.uniform2f(uniforms.slopes, ...slopes.map(Math.abs));
    gl.uniform1f(uniforms.middle, middle);
    const height = Math.max(Math.abs(slopes[1]), 0.05) * middle * 1.15;
    const aspect = canvas.width / canvas.height;
    this.camera = { matrix: look(this, middle, height, aspect), middle };
    gl.uniformMatrix4fv(uniforms.camera, false, this.camera.matrix);
    gl.uniform1f(uniforms.dot, (1.7 * canvas.height) / picture.rows / this.away);
    gl.drawArrays(gl.POINTS, 0, picture.rows * picture.cols);
  }
}

/** Matrix of the perspective, column by column; the scene is turned about its middle. */
function look({ turn, tilt, away }, middle, height, aspect) {
  const [st, ct, sp, cp] = [Math.sin(turn), Math.cos(turn), Math.sin(tilt), Math.cos(tilt)];
  const rows = [
    [ct, 0, st, 0],
    [sp * st, cp, -sp * ct, 0],
    [-cp * st, sp, cp * ct, -middle * away],
  ];
  const focal = middle / height;
  const [near, far] = [middle * 0.05, middle * 12];
  const depth = [(far + near) / (near - far), (2 * far * near) / (near - far)];
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) {
    out[4 * c] = (focal / aspect) * rows[0][c];
    out[4 * c + 1] = focal * rows[1][c];
    out[4 * c + 2] = depth[0] * rows[2][c] + (c === 3 ? depth[1] : 0);
    out[4 * c + 3] = -rows[2][c];
  }
  return out;
}
