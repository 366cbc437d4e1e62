// The display as a fragment shader: what one pixel of an eye's picture is made of.

export const VERTEX = `#version 300 es
void main() {  // one triangle that covers the picture
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1);
}`;

// Texels are fetched and mixed here, because hardware filtering rounds its weights to 8 bits.
export const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;

uniform sampler2DArray high, low;   // codes of all pictures, subframe by subframe
uniform sampler2D decoded, encoded; // light of every code; values over the root of light
uniform sampler2D target;
uniform bool deep, transfer;        // 16 bit; whether values are other than light
uniform int shown, link, layers, subframes, picture;
uniform float neutral, gain;
uniform vec2 origin, size, margin;  // of the picture on the canvas; pixels
uniform vec3 path[8];               // magnification, shift across and down, of every layer
out vec4 colour;

const float HALF_TURN = 1.5707963267948966;

vec3 code(ivec3 place) {
  vec3 first = texelFetch(high, place, 0).rgb * 255.0;
  return floor((deep ? first * 256.0 + texelFetch(low, place, 0).rgb * 255.0 : first) + 0.5);
}

float lightOf(float code) {
  int c = int(code);
  return texelFetch(decoded, ivec2(c & 255, c >> 8), 0).r;
}

vec3 texel(ivec3 place) {
  ivec2 end = textureSize(high, 0).xy;
  if (place.x < 0 || place.y < 0 || place.x >= end.x || place.y >= end.y) return vec3(neutral);
  vec3 c = code(place);
  return transfer ? vec3(lightOf(c.r), lightOf(c.g), lightOf(c.b)) : c / (deep ? 65535.0 : 255.0);
}

vec3 pixel(vec2 at, int index) {
  vec2 whole = floor(at), part = at - whole;
  ivec3 place = ivec3(ivec2(whole), index);
  vec3 above = mix(texel(place), texel(place + ivec3(1, 0, 0)), part.x);
  if (part.y == 0.0) return above;
  vec3 below = mix(texel(place + ivec3(0, 1, 0)), texel(place + ivec3(1, 1, 0)), part.x);
  return mix(above, below, part.y);
}

vec3 composed(vec2 at, int subframe) {
  vec2 centre = (size - 1.0) / 2.0;
  vec3 light = vec3(link == MULTIPLICATIVE ? 1.0 : 0.0);
  for (int k = 0; k < layers; k++) {
    vec2 meets = margin + centre + path[k].x * (at - centre) + path[k].yz;
    vec3 met = pixel(meets, subframe * layers + k);
    light = link == MULTIPLICATIVE ? light * met : light + met;
  }
  vec3 turned = sin(light * HALF_TURN);
  return link == POLARISATION ? turned * turned : light;
}

float valueOf(float light) {
  float last = float(textureSize(encoded, 0).x - 1);
  float place = sqrt(light) * last, whole = min(floor(place), last - 1.0);
  float a = texelFetch(encoded, ivec2(whole, 0), 0).r;
  float b = texelFetch(encoded, ivec2(whole + 1.0, 0), 0).r;
  return mix(a, b, place - whole);
}

vec3 seen(vec2 at) {
  vec3 light = vec3(0);
  for (int s = 0; s < subframes; s++) light += composed(at, s);
  light = clamp(light / float(subframes), 0.0, 1.0);
  return transfer ? vec3(valueOf(light.r), valueOf(light.g), valueOf(light.b)) : light;
}

vec3 diverging(float error) {  // blue: too dark, red: too bright
  vec3 end = error < 0.0 ? vec3(0.13, 0.40, 0.67) : vec3(0.70, 0.09, 0.17);
  return mix(vec3(0.97), end, min(abs(error) * gain, 1.0));
}

void main() {
  vec2 at = floor(gl_FragCoord.xy - origin);
  at.y = size.y - 1.0 - at.y;
  vec3 value;
  if (shown == PICTURE) value = code(ivec3(at, picture)) / (deep ? 65535.0 : 255.0);
  else if (shown == TARGET) value = texelFetch(target, ivec2(at), 0).rgb;
  else value = seen(at);
  if (shown == DIFFERENCE)
    value = diverging(dot(value - texelFetch(target, ivec2(at), 0).rgb, vec3(1.0 / 3.0)));
  colour = vec4(value, 1);
}`;
