#version 450
#include "../common/buffers.glsl"
#include "../common/surface.glsl"

struct LightBuffer {
  mat4 viewMatrix;
  mat4 viewMatrixInverse;
  mat4 projectionMatrix;
  mat4 projectionMatrixInverse;
  int width;
  int height;
};

layout(set = 3, binding = 1) uniform ShadowBuffer {
  LightBuffer pointLightBuffers[60];
  LightBuffer directionalLightBuffers[3];
  LightBuffer spotLightBuffers[10];
  LightBuffer texturedLightBuffers[1];
} shadowBuffer;

layout(set = 3, binding = 2) uniform samplerCube samplerPointLightDepths[10];
layout(set = 3, binding = 3) uniform sampler2D samplerDirectionalLightDepths[3];
layout(set = 3, binding = 4) uniform sampler2D samplerSpotLightDepths[10];
layout(set = 3, binding = 5) uniform sampler2D samplerTexturedLightDepths[1];
layout(set = 3, binding = 6) uniform sampler2D samplerTexturedLightTextures[1];

// Metres by which a surface is lifted towards viewer and light, so that it does not shade itself.
const float LIFT = 0.004;

// Share of 3 x 3 texels of the light's depth map that see the point (percentage closer filtering,
// Reeves, Salesin and Cook 1987).
float seenByTheLight() {
  vec3 lifted = inWorld + LIFT * (normalize(inNormal) - sceneBuffer.directionalLights[0].direction.xyz);
  LightBuffer light = shadowBuffer.directionalLightBuffers[0];
  vec4 place = light.projectionMatrix * light.viewMatrix * vec4(lifted, 1.0);
  vec3 map = place.xyz / place.w;
  map.xy = 0.5 * map.xy + 0.5;
  vec2 texel = 1.0 / vec2(textureSize(samplerDirectionalLightDepths[0], 0));
  float seen = 0.0;
  for (int i = -1; i <= 1; ++i) {
    for (int j = -1; j <= 1; ++j) {
      seen += step(map.z, texture(samplerDirectionalLightDepths[0], map.xy + vec2(i, j) * texel).x);
    }
  }
  return seen / 9.0;
}

void main() {
  writeSurface(seenByTheLight());
}
