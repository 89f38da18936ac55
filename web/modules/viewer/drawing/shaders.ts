// The shaders. Colours come from the tokens unchanged; everything fades into the paper.

const FADE = /* glsl */ `
uniform vec3 paper;
uniform vec2 fade;
uniform vec2 cut;
bool isCut(float height) { return height < cut.x || height >= cut.y; }
vec3 faded(vec3 colour, float away) { return mix(colour, paper, smoothstep(fade.x, fade.y, away)); }
`;

/** Corners as packed by \`faces.ts\`. Quads are widened minimally, so that nothing shines through their seams. */
export const VOXEL_VERTEX = /* glsl */ `
in uvec4 corner;
uniform sampler2D palette;
uniform float light[6];
out vec3 colour;
out vec2 at;
out float away;
void main() {
  int word = int(corner.w);
  int direction = (word >> 8) & 7;
  int axis = direction >> 1;
  vec2 wider = vec2((word >> 13) & 1, (word >> 14) & 1) * 2.0 - 1.0;
  vec3 place = vec3(corner.xyz);
  at = axis == 0 ? place.yz : axis == 1 ? place.zx : place.xy;
  vec2 edge = wider * 0.015;
  place += axis == 0 ? vec3(0.0, edge) : axis == 1 ? vec3(edge.y, 0.0, edge.x) : vec3(edge, 0.0);
  float open = float((word >> 11) & 3) / 3.0;
  colour = texelFetch(palette, ivec2(word & 255, 0), 0).rgb * light[direction] * mix(0.82, 1.0, open);
  vec4 seen = modelViewMatrix * vec4(place, 1.0);
  away = length(seen.xyz);
  gl_Position = projectionMatrix * seen;
}`;

export const VOXEL_FRAGMENT = /* glsl */ `
precision highp float;
in vec3 colour;
in vec2 at;
in float away;
uniform float edges;
uniform float hatch;
out vec4 painted;
${FADE}
void main() {
  vec2 width = fwidth(at);
  vec2 near = abs(fract(at - 0.5) - 0.5) / max(width, vec2(1e-4));
  float line = (1.0 - smoothstep(0.4, 1.4, min(near.x, near.y))) * clamp(1.0 - 2.6 * max(width.x, width.y), 0.0, 1.0);
  float across = (at.x + at.y) * 2.0;
  float stripe = mix(0.5, smoothstep(0.3, 0.7, abs(fract(across) - 0.5) * 2.0), clamp(1.5 - 3.0 * fwidth(across), 0.0, 1.0));
  vec3 inked = mix(colour * (1.0 - edges * line), paper, hatch * stripe);
  painted = vec4(faded(inked, away), 1.0);
}`;

export const SURFACE_VERTEX = /* glsl */ `
in float kind;
uniform vec3 kinds[4];
out vec3 colour;
out vec3 seenFrom;
out float height;
void main() {
  colour = kinds[int(kind + 0.5)];
  height = (modelMatrix * vec4(position, 1.0)).z;
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  seenFrom = seen.xyz;
  gl_Position = projectionMatrix * seen;
}`;

export const SURFACE_FRAGMENT = /* glsl */ `
precision highp float;
in vec3 colour;
in vec3 seenFrom;
in float height;
uniform vec3 sun;
out vec4 painted;
${FADE}
void main() {
  if (isCut(height)) discard;
  vec3 normal = normalize(cross(dFdx(seenFrom), dFdy(seenFrom)));
  float lit = 0.72 + 0.3 * max(0.0, dot(normal, sun));
  painted = vec4(faded(colour * lit, length(seenFrom)), 1.0);
}`;

export const CLOUD_VERTEX = /* glsl */ `
in float strength;
uniform float pixels;
uniform float size;
uniform sampler2D ramp;
uniform int by;
uniform float age;
uniform float ground;
uniform vec2 range;
out vec3 colour;
out float away;
out float height;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  height = (modelMatrix * vec4(position, 1.0)).z;
  float value = by == 0 ? strength * 255.0 : by == 1 ? height - ground : age;
  float share = clamp((value - range.x) / (range.y - range.x), 0.0, 1.0);
  colour = texelFetch(ramp, ivec2(int(share * 255.0 + 0.5), 0), 0).rgb;
  away = length(seen.xyz);
  gl_Position = projectionMatrix * seen;
  gl_PointSize = clamp(pixels * 0.07 / away, 1.5, 6.0) * size;
}`;

export const CLOUD_FRAGMENT = /* glsl */ `
precision highp float;
in vec3 colour;
in float away;
in float height;
out vec4 painted;
${FADE}
void main() {
  if (isCut(height)) discard;
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  painted = vec4(faded(colour, away), 1.0);
}`;

export const GROUND_VERTEX = /* glsl */ `
out vec2 at;
void main() {
  vec4 place = modelMatrix * vec4(position, 1.0);
  at = place.xy;
  gl_Position = projectionMatrix * viewMatrix * place;
}`;

/** Lines every two metres near by and every ten metres farther, fading outwards from \`middle\`. */
export const GROUND_FRAGMENT = /* glsl */ `
precision highp float;
in vec2 at;
uniform vec3 ink;
uniform vec2 middle;
uniform float reach;
out vec4 painted;
float lines(float each) {
  vec2 place = at / each;
  vec2 width = fwidth(place);
  vec2 near = abs(fract(place - 0.5) - 0.5) / max(width, vec2(1e-5));
  return (1.0 - smoothstep(0.0, 1.2, min(near.x, near.y))) * clamp(1.0 - 3.0 * max(width.x, width.y), 0.0, 1.0);
}
void main() {
  float strength = max(0.1 * lines(2.0), 0.28 * lines(10.0));
  float near = 1.0 - smoothstep(0.25 * reach, reach, distance(at, middle));
  painted = vec4(ink, strength * near);
}`;
