// The programs that run on the graphics card, in GLSL ES 3.00. Colours come in sRGB and are mixed as light.

const LIGHT = `
vec3 light_of(vec3 srgb) { return pow(srgb, vec3(2.2)); }
vec3 srgb_of(vec3 light) { return pow(clamp(light, 0.0, 1.0), vec3(1.0 / 2.2)); }
`;

const TURN = `
vec3 turned(vec4 q, vec3 v) { return v + 2.0 * cross(q.yzw, cross(q.yzw, v) + q.x * v); }
`;

// Share of the sun's light at a place: nine samples of the depth map, so that edges of shadows are soft.
const SHADOW = `
uniform highp sampler2DShadow depths;
uniform mat4 sun;
float sunlit(vec3 place, vec3 normal) {
  vec4 seen = sun * vec4(place + 0.008 * normal, 1.0);
  vec3 at = seen.xyz * 0.5 + 0.5;
  if (any(lessThan(at, vec3(0.0))) || any(greaterThan(at, vec3(1.0)))) return 1.0;
  float texel = 1.2 / float(textureSize(depths, 0).x);
  float sum = 0.0;
  for (int i = -1; i <= 1; i++)
    for (int j = -1; j <= 1; j++) sum += texture(depths, vec3(at.xy + texel * vec2(i, j), at.z - 0.0012));
  return sum / 9.0;
}
`;

const SHADE = `
uniform vec3 sunward, eye;
vec3 shaded(vec3 colour, vec3 place, vec3 normal) {
  float sky = 0.5 + 0.5 * normal.z;
  float key = max(dot(normal, sunward), 0.0) * sunlit(place, normal);
  float fill = max(dot(normal, normalize(eye - place)), 0.0);
  return light_of(colour) * (0.26 + 0.22 * sky + 0.52 * key + 0.2 * fill);
}
`;

export const BOX_VERTEX = `#version 300 es
layout(location = 0) in vec3 corner;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 centre;
layout(location = 3) in vec4 turn;
layout(location = 4) in vec3 half_size;
layout(location = 5) in vec4 colour;
layout(location = 6) in vec4 edge;
uniform mat4 clip;
out vec3 on_box, place, facing;
flat out vec3 reach, flat_normal;
flat out vec4 tint, line;
${TURN}
void main() {
  on_box = corner * half_size;
  reach = half_size;
  flat_normal = normal;
  tint = colour;
  line = edge;
  facing = turned(turn, normal);
  place = centre + turned(turn, on_box);
  gl_Position = clip * vec4(place, 1.0);
}`;

// `edge` is the colour of the lines along a box's edges, and their width in pixels. The place of a pixel on its face
// determines whether the pixel is on such a line.
export const BOX_FRAGMENT = `#version 300 es
precision highp float;
in vec3 on_box, place, facing;
flat in vec3 reach, flat_normal;
flat in vec4 tint, line;
uniform float lines; // opacity of the lines
uniform bool lit;
out vec4 pixel;
${LIGHT}${SHADOW}${SHADE}
void main() {
  vec3 away = (reach - abs(on_box)) / max(fwidth(on_box), vec3(1e-7)) + abs(flat_normal) * 1e6;
  float nearest = min(away.x, min(away.y, away.z));
  float on_line = lines * (1.0 - smoothstep(line.w - 0.5, line.w + 0.5, nearest));
  vec3 face = lit ? shaded(tint.rgb, place, normalize(facing)) : light_of(tint.rgb);
  float alpha = mix(tint.a, 1.0, on_line);
  pixel = vec4(srgb_of(mix(face, light_of(line.rgb), on_line)) * alpha, alpha);
}`;

export const DEPTH_FRAGMENT = `#version 300 es
precision highp float;
void main() {}`;

export const ARROW_VERTEX = `#version 300 es
layout(location = 0) in vec4 corner; // w: 0 shaft, 1 head
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 start;
layout(location = 3) in vec3 vector;
layout(location = 4) in vec4 colour; // a: radius, m
uniform mat4 clip;
out vec3 place, facing;
flat out vec3 tint;
void main() {
  float length_m = max(length(vector), 1e-6);
  vec3 along = vector / length_m;
  vec3 side = normalize(abs(along.z) < 0.9 ? cross(along, vec3(0, 0, 1)) : cross(along, vec3(1, 0, 0)));
  vec3 other = cross(along, side);
  float radius = min(colour.a, 0.15 * length_m);
  float head = min(6.0 * radius, 0.5 * length_m);
  vec2 across = corner.xy * radius * (corner.w > 0.5 ? 2.4 : 1.0);
  float height = corner.w > 0.5 ? length_m - head + corner.z * head : corner.z * (length_m - head);
  place = start + side * across.x + other * across.y + along * height;
  facing = side * normal.x + other * normal.y + along * normal.z;
  tint = colour.rgb;
  gl_Position = clip * vec4(place, 1.0);
}`;

export const ARROW_FRAGMENT = `#version 300 es
precision highp float;
in vec3 place, facing;
flat in vec3 tint;
uniform vec3 eye;
out vec4 pixel;
${LIGHT}
void main() {
  float fill = abs(dot(normalize(facing), normalize(eye - place)));
  pixel = vec4(srgb_of(light_of(tint) * (0.45 + 0.55 * fill)), 1.0);
}`;

export const FLOOR_VERTEX = `#version 300 es
layout(location = 0) in vec2 corner;
uniform mat4 clip;
uniform vec3 middle;
uniform float reach;
out vec3 place;
void main() {
  place = middle + vec3(corner * reach, 0.0);
  gl_Position = clip * vec4(place, 1.0);
}`;

// Lines every half metre, and shadows; both fade away from the pallet, so that the page is the background.
export const FLOOR_FRAGMENT = `#version 300 es
precision highp float;
in vec3 place;
uniform vec3 middle, ground, ruled;
uniform float reach, shade;
out vec4 pixel;
${LIGHT}${SHADOW}
void main() {
  float fade = 1.0 - smoothstep(0.35, 1.0, length(place.xy - middle.xy) / reach);
  vec2 cell = (place.xy - middle.xy) / 0.5;
  vec2 away = abs(fract(cell - 0.5) - 0.5) / fwidth(cell);
  float line = (1.0 - min(min(away.x, away.y), 1.0)) * 0.8;
  float dark = shade * (1.0 - sunlit(place, vec3(0, 0, 1)));
  vec3 colour = mix(mix(ground, ruled, line), vec3(0.0), dark);
  float alpha = fade * max(max(0.55, line * 0.8), dark);
  pixel = vec4(colour * alpha, alpha);
}`;
