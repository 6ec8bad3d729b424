/* What an engine needs of a Kiln bake: docs/runtime.md and docs/pack-format.md of Kiln. Written from crates/kiln-runtime/src/c_api
   by `cargo xtask header`. Points are metres relative to the level's origin; AO is from 0 to 1, 1 open. */

#ifndef KILN_RUNTIME_H
#define KILN_RUNTIME_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

// No index: of a node without instances, or no hint.
#define KILN_NONE UINT32_MAX

// Channels (half-distances) of a pack at most.
#define KILN_MAX_CHANNELS 4

// Words of a KilnPack.
#define KILN_PACK_WORDS 128

// What became of a call.
typedef enum KilnStatus {
  // It worked.
  KILN_STATUS_OK = 0,
  // A pointer is null.
  KILN_STATUS_NULL_POINTER = 1,
  // The pack was not opened, or it was closed.
  KILN_STATUS_NOT_OPEN = 2,
  // The bytes are no pack.
  KILN_STATUS_NOT_A_PACK = 3,
  // The pack has a format that this runtime does not know.
  KILN_STATUS_UNKNOWN_VERSION = 4,
  // The pack is cut off.
  KILN_STATUS_CUT_OFF = 5,
  // The pack is damaged; kiln_pack_error says how.
  KILN_STATUS_DAMAGED = 6,
  // There is nothing at this index, or of this name.
  KILN_STATUS_NOT_FOUND = 7,
  // The point is not finite, or the pack has no regions.
  KILN_STATUS_NO_REGION = 8,
} KilnStatus;

// An open pack, in memory of the caller's. It may be moved, but not copied while another thread opens it.
typedef struct KilnPack {
  // The runtime's own.
  uint64_t opaque[KILN_PACK_WORDS];
} KilnPack;

// What was baked, and how much of it there is.
typedef struct KilnPackInfo {
  // Where points are relative to, metres in the level's own coordinates.
  double origin[3];
  // Digest of the level.
  uint8_t level_digest[32];
  // Half-distance of each channel, metres.
  float half_distances[KILN_MAX_CHANNELS];
  // Weight of each channel in the blend; their sum is 1.
  float blend[KILN_MAX_CHANNELS];
  // Number of channels.
  uint32_t channels;
  // 0 obscurance, 1 occlusion, other numbers what this version does not know.
  uint32_t kernel;
  // Number of vertex sets.
  uint32_t vertex_sets;
  // Number of models of trees.
  uint32_t tree_models;
  // Number of instances of them.
  uint32_t tree_instances;
  // Number of shrubs and decorators.
  uint32_t scalars;
  // Number of visibility regions.
  uint32_t regions;
  // Number of their models.
  uint32_t models;
} KilnPackInfo;

// A visibility region.
typedef struct KilnRegion {
  // Its box's lowest corner.
  float min[3];
  // Its box's highest corner.
  float max[3];
  // Index of its model.
  uint32_t model;
} KilnRegion;

// What an engine keeps for a moving object. Begin with kiln_moving_object_new.
typedef struct KilnMovingObject {
  // Linear coefficients of AO as last shown.
  float coefficients[4];
  // Region that it was in last, or KILN_NONE.
  uint32_t region;
  // 0 before it is shown for the first time.
  uint32_t is_shown;
} KilnMovingObject;

// Values of vertices: vertex by vertex, in it channel by channel.
typedef struct KilnValues {
  // As they are stored; they stay as long as the pack's bytes.
  const uint8_t *bytes;
  // Their size.
  size_t size;
  // Number of vertices.
  uint32_t vertex_count;
  // Whether they are 32-bit floats; else normalised 16-bit integers.
  bool is_f32;
} KilnValues;

// An instance of a model of trees.
typedef struct KilnTree {
  // Four numbers for each channel.
  float numbers[KILN_MAX_CHANNELS][4];
  // Those of the blend.
  float blend[4];
  // Centre of the model's box, in its mesh's space.
  float center[3];
  // Half of the box's size.
  float half_extent[3];
  // Index of the model.
  uint32_t model;
  // Index of its mesh in the source.
  uint32_t mesh;
  // How many primitives of it have local AO.
  uint32_t block_count;
} KilnTree;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Version of the pack format that this runtime reads: major × 65,536 + minor.
uint32_t kiln_format_version(void);

// A status in words. The text stays.
const char *kiln_status_text(uint32_t status);

// Checks the bytes of a pack and opens it into `pack`. Bytes may be a memory-mapped file; they need no alignment.
//
// # Safety
// `bytes` points to `length` bytes that stay and do not change while the pack is open; `pack` to a KilnPack.
enum KilnStatus kiln_pack_open(const uint8_t *bytes,
                               size_t length,
                               struct KilnPack *pack);

// Closes a pack: calls then give KILN_STATUS_NOT_OPEN. There is nothing to free.
//
// # Safety
// `pack` is null or points to a KilnPack.
void kiln_pack_close(struct KilnPack *pack);

// Why bytes are no pack, as text that ends in 0 and is cut to `capacity` bytes; empty if they are one.
//
// # Safety
// `bytes` points to `length` bytes, `text` to `capacity` bytes.
enum KilnStatus kiln_pack_error(const uint8_t *bytes,
                                size_t length,
                                char *text,
                                size_t capacity);

// What was baked, and how much of it there is.
//
// # Safety
// `pack` points to a KilnPack that was opened, `info` to a KilnPackInfo.
enum KilnStatus kiln_pack_info(const struct KilnPack *pack, struct KilnPackInfo *info);

// All records of a kind of section (docs/pack-format.md), for an upload as they are: where they begin, the size of each,
// and how many there are. They stay as long as the pack's bytes.
//
// # Safety
// `pack` points to a KilnPack that was opened, the others to what they are to hold.
enum KilnStatus kiln_pack_records(const struct KilnPack *pack,
                                  uint32_t kind,
                                  const uint8_t **records,
                                  size_t *stride,
                                  size_t *count);

// The curve that the level's author asked for over the blend. AO as it is where the pack is not open.
//
// # Safety
// `pack` points to a KilnPack that was opened.
float kiln_pack_remap(const struct KilnPack *pack,
                      float ao);

// A region by its index.
//
// # Safety
// `pack` points to a KilnPack that was opened, `region` to a KilnRegion.
enum KilnStatus kiln_region(const struct KilnPack *pack, uint32_t index, struct KilnRegion *region);

// The index of the region that the level's author calls so: UTF-8, `length` bytes. Looks at all regions.
//
// # Safety
// `pack` points to a KilnPack that was opened, `id` to `length` bytes, `index` to a number.
enum KilnStatus kiln_region_with_id(const struct KilnPack *pack,
                                    const uint8_t *id,
                                    size_t length,
                                    uint32_t *index);

// The region of a point (three floats): the smallest box that contains it, else the nearest. `hint` is the region it was in
// before, or KILN_NONE. `distance` is that from the box, 0 within; it may be null.
//
// # Safety
// `pack` points to a KilnPack that was opened, `point` to three floats, `region` to a number.
enum KilnStatus kiln_region_at(const struct KilnPack *pack,
                               const float *point,
                               uint32_t hint,
                               uint32_t *region,
                               float *distance);

// Four linear coefficients of the blended AO in a region, at the point (three floats) of its box that is nearest.
//
// # Safety
// `pack` points to a KilnPack that was opened, `point` to three floats, `coefficients` to four.
enum KilnStatus kiln_region_engine(const struct KilnPack *pack,
                                   uint32_t region,
                                   const float *point,
                                   float *coefficients);

// Nine quadratic coefficients of a channel's AO in a region, at the point (three floats) of its box that is nearest.
//
// # Safety
// `pack` points to a KilnPack that was opened, `point` to three floats, `coefficients` to nine.
enum KilnStatus kiln_region_full(const struct KilnPack *pack,
                                 uint32_t region,
                                 uint32_t channel,
                                 const float *point,
                                 float *coefficients);

// AO for a unit normal (three floats) from four linear coefficients. 0 where a pointer is null.
//
// # Safety
// `coefficients` points to four floats, `normal` to three.
float kiln_ao_linear(const float *coefficients, const float *normal);

// AO for a unit normal (three floats) from nine quadratic coefficients. 0 where a pointer is null.
//
// # Safety
// `coefficients` points to nine floats, `normal` to three.
float kiln_ao_quadratic(const float *coefficients, const float *normal);

// Weight of the present after `dt_secs`: 1 − 2^(−dt / half-time). 0.1 s is what Kiln suggests; 0 for no blending.
float kiln_temporal_weight(float dt_secs,
                           float half_time_secs);

// Draws `count` coefficients as shown before towards those of now, in place.
//
// # Safety
// `shown` and `now` point to `count` floats each, which do not overlap.
enum KilnStatus kiln_temporal_blend(float *shown,
                                    const float *now,
                                    size_t count,
                                    float dt_secs,
                                    float half_time_secs);

// An object that appears: it gets its first value at once.
struct KilnMovingObject kiln_moving_object_new(void);

// Moves an object to a point (three floats), `dt_secs` after the last call: finds its region, evaluates the model there, and
// blends. Its coefficients then are what to show. Nothing changes where the status is not KILN_STATUS_OK.
//
// # Safety
// `pack` points to a KilnPack that was opened, `object` to a KilnMovingObject, `point` to three floats.
enum KilnStatus kiln_moving_object_update(const struct KilnPack *pack,
                                          struct KilnMovingObject *object,
                                          const float *point,
                                          float dt_secs,
                                          float half_time_secs);

// Values of a primitive's vertices on a node, or on an instance of EXT_mesh_gpu_instancing, else KILN_NONE.
//
// # Safety
// `pack` points to a KilnPack that was opened, `values` to a KilnValues.
enum KilnStatus kiln_vertex_values(const struct KilnPack *pack,
                                   uint32_t node,
                                   uint32_t gpu_instance,
                                   uint32_t primitive,
                                   struct KilnValues *values);

// The tree at a node, or at an instance of EXT_mesh_gpu_instancing, else KILN_NONE.
//
// # Safety
// `pack` points to a KilnPack that was opened, `tree` to a KilnTree.
enum KilnStatus kiln_tree(const struct KilnPack *pack,
                          uint32_t node,
                          uint32_t gpu_instance,
                          struct KilnTree *tree);

// Local AO of a primitive of a model of trees: the `block`-th that has some, and which it is.
//
// # Safety
// `pack` points to a KilnPack that was opened, `primitive` to a number, `values` to a KilnValues.
enum KilnStatus kiln_tree_values(const struct KilnPack *pack,
                                 uint32_t model,
                                 uint32_t block,
                                 uint32_t *primitive,
                                 struct KilnValues *values);

// AO of a vertex of a tree from its local AO, the instance's four numbers, and its place (three floats) in the model's box:
// (position − center) / half_extent. 0 where a pointer is null.
//
// # Safety
// `numbers` points to four floats, `place` to three.
float kiln_tree_ao(float local,
                   const float *numbers,
                   const float *place);

// AO of the shrub or decorator at a node, or at an instance of EXT_mesh_gpu_instancing, else KILN_NONE: one value for each
// channel, 0 for channels that are not there.
//
// # Safety
// `pack` points to a KilnPack that was opened, `values` to KILN_MAX_CHANNELS floats.
enum KilnStatus kiln_scalar(const struct KilnPack *pack,
                            uint32_t node,
                            uint32_t gpu_instance,
                            float *values);

// The dither of a pixel in a frame, a fraction of 2³²; frame 0 for a pattern that stands still.
uint32_t kiln_dither(uint32_t x, uint32_t y, uint32_t frame);

// AO in 31 steps, 0 to 31, rounded up or down by a dither; 0x80000000 gives the nearest.
uint32_t kiln_quantise(float ao, uint32_t dither);

// AO of 0 to 31 steps.
float kiln_dequantise(uint32_t steps);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* KILN_RUNTIME_H */
