// What SAPIEN's rasteriser binds for fragments: material and lights.

layout(set = 2, binding = 0) uniform MaterialBuffer {
  vec4 emission;
  vec4 baseColor;
  float fresnel;
  float roughness;
  float metallic;
  float transmission;
  float ior;
  float transmissionRoughness;
  int textureMask;
  int padding1;
  vec4 textureTransforms[6];
} materialBuffer;

layout(set = 2, binding = 1) uniform sampler2D colorTexture;
layout(set = 2, binding = 2) uniform sampler2D roughnessTexture;
layout(set = 2, binding = 3) uniform sampler2D normalTexture;
layout(set = 2, binding = 4) uniform sampler2D metallicTexture;
layout(set = 2, binding = 5) uniform sampler2D emissionTexture;
layout(set = 2, binding = 6) uniform sampler2D transmissionTexture;

struct PointLight { vec4 position; vec4 emission; };
struct DirectionalLight { vec4 direction; vec4 emission; };
struct SpotLight { vec4 position; vec4 direction; vec4 emission; };

layout(set = 3, binding = 0) uniform SceneBuffer {
  vec4 ambientLight;
  PointLight pointLights[10];
  DirectionalLight directionalLights[3];
  SpotLight spotLights[10];
  SpotLight texturedLights[1];
} sceneBuffer;

layout(location = 0) in vec3 inCamera;
layout(location = 1) in vec3 inWorld;
layout(location = 2) in vec3 inNormal;
layout(location = 3) in vec2 inPlace;

layout(location = 0) out uvec4 outPacked;

// Lambert's law (normals come turned to the viewer), display gamma 2.2. Packed: colour and the
// surface's code (alpha of the emission) as four bytes; depth along the optical axis in metres.
void writeSurface(float visibility) {
  vec3 normal = normalize(inNormal);
  float cosine = max(0.0, -dot(normal, sceneBuffer.directionalLights[0].direction.xyz));
  vec3 light = sceneBuffer.ambientLight.rgb
             + visibility * cosine * sceneBuffer.directionalLights[0].emission.rgb;
  vec3 surface = materialBuffer.baseColor.rgb;
  if ((materialBuffer.textureMask & 1) != 0) {
    surface = texture(colorTexture, inPlace).rgb;
  }
  vec3 linear = clamp(surface * light, vec3(0.0), vec3(1.0));
  uvec3 colour = uvec3(round(255.0 * pow(linear, vec3(1.0 / 2.2))));
  uint code = uint(round(materialBuffer.emission.a));
  outPacked = uvec4(colour.r | (colour.g << 8) | (colour.b << 16) | (code << 24),
                    floatBitsToUint(-inCamera.z), 0u, 0u);
}
