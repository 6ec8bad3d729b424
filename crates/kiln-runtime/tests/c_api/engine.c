/* What an engine does with a pack, in C: prints what it finds, which the test compares with Rust's. */
#include "kiln_runtime.h"

#include <stdio.h>
#include <string.h>

static void print(const char *name, const float *values, size_t count) {
    printf("%s", name);
    for (size_t i = 0; i < count; i++) {
        printf(" %.9g", (double)values[i]);
    }
    printf("\n");
}

static void refusals(const uint8_t *bytes, size_t size) {
    KilnPack pack;
    char text[40];
    uint32_t region;
    const float nowhere[3] = {0.0f / 1.0f, 0.0f, 0.0f};
    printf("null %d %d\n", kiln_pack_open(NULL, 0, &pack), kiln_pack_open(bytes, size, NULL));
    printf("not open %d\n", kiln_region_at(&pack, nowhere, KILN_NONE, &region, NULL));
    printf("cut off %d\n", kiln_pack_open(bytes, size - 1, &pack));
    printf("no pack %d\n", kiln_pack_open((const uint8_t *)"glTF....", 8, &pack));
    kiln_pack_error((const uint8_t *)"glTF....", 8, text, sizeof text);
    printf("error %s\n", text);
    kiln_pack_error(bytes, size, text, sizeof text);
    printf("no error %s.\n", text);
    printf("status %s\n", kiln_status_text(KILN_STATUS_NOT_OPEN));
}

static void moving(const KilnPack *pack) {
    const float point[3] = {5.0f, 1.0f, 3.5f}, normal[3] = {0.0f, 0.6f, 0.8f};
    float distance, engine[4], full[9], ao[2];
    uint32_t region, kitchen;
    KilnRegion box;
    printf("at %d", kiln_region_at(pack, point, KILN_NONE, &region, &distance));
    printf(" %u %g\n", region, (double)distance);
    printf("kitchen %d", kiln_region_with_id(pack, (const uint8_t *)"kitchen", 7, &kitchen));
    printf(" %u\n", kitchen);
    kiln_region(pack, region, &box);
    print("box", box.min, 3);
    kiln_region_engine(pack, region, point, engine);
    kiln_region_full(pack, region, 1, point, full);
    print("engine", engine, 4);
    print("full", full, 9);
    ao[0] = kiln_ao_linear(engine, normal);
    ao[1] = kiln_ao_quadratic(full, normal);
    print("ao", ao, 2);
    printf("no channel %d\n", kiln_region_full(pack, region, 2, point, full));

    KilnMovingObject object = kiln_moving_object_new();
    const float hall[3] = {1.0f, 1.0f, 1.0f};
    kiln_moving_object_update(pack, &object, hall, 0.0f, 0.1f);
    kiln_moving_object_update(pack, &object, point, 0.05f, 0.1f);
    print("moved", object.coefficients, 4);
    printf("to %u\n", object.region);
    kiln_temporal_blend(engine, full, 4, 0.1f, 0.1f);
    print("halfway", engine, 4);
}

static void still(const KilnPack *pack) {
    KilnValues values;
    KilnTree tree;
    float scalar[KILN_MAX_CHANNELS], first[2];
    const float place[3] = {0.5f, -1.0f, 0.25f};
    uint32_t primitive;
    printf("vertices %d", kiln_vertex_values(pack, 7, KILN_NONE, 2, &values));
    memcpy(first, values.bytes + values.size - sizeof first, sizeof first);
    printf(" %u %d %zu\n", values.vertex_count, values.is_f32, values.size);
    print("last", first, 2);
    printf("none %d\n", kiln_vertex_values(pack, 7, 0, 2, &values));
    kiln_tree(pack, 12, KILN_NONE, &tree);
    first[0] = kiln_tree_ao(0.75f, tree.numbers[1], place);
    first[1] = kiln_tree_ao(0.75f, tree.blend, place);
    print("tree", first, 2);
    printf("block %d", kiln_tree_values(pack, tree.model, 1, &primitive, &values));
    printf(" %u %u\n", primitive, values.vertex_count);
    kiln_scalar(pack, 20, 5, scalar);
    print("scalar", scalar, KILN_MAX_CHANNELS);
    first[0] = kiln_pack_remap(pack, 0.25f);
    print("remap", first, 1);
}

int main(int count, char **arguments) {
    static uint8_t bytes[65536];
    FILE *file = count > 1 ? fopen(arguments[1], "rb") : NULL;
    if (!file) {
        return 2;
    }
    size_t size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    refusals(bytes, size);

    KilnPack pack;
    KilnPackInfo info;
    const uint8_t *records;
    size_t stride, records_count;
    printf("open %d\n", kiln_pack_open(bytes, size, &pack));
    kiln_pack_info(&pack, &info);
    printf("info %u %u %u %g %g\n", info.channels, info.regions, info.models, (double)info.half_distances[1], info.origin[1]);
    kiln_pack_records(&pack, 14, &records, &stride, &records_count);
    printf("records %zu %zu %d\n", stride, records_count, records > bytes && records < bytes + size);
    moving(&pack);
    still(&pack);
    uint32_t dither = kiln_dither(17, 4, 2);
    printf("five bits %u %u %g\n", dither, kiln_quantise(0.71f, dither), (double)kiln_dequantise(31));
    printf("half %g\n", (double)kiln_temporal_weight(0.1f, 0.1f));
    kiln_pack_close(&pack);
    printf("closed %d\n", kiln_pack_info(&pack, &info));
    printf("version %u\n", kiln_format_version());
    return 0;
}
