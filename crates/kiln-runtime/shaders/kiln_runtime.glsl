// Written from kiln_runtime.wgsl by `cargo xtask shaders`: change that file, and see it for what functions do.
// Needs #version 420, or #version 310 es.

struct KilnLinearModel {
    vec3 middle;
    vec4 mean;
    vec4 x_above;
    vec4 x_below;
    vec4 y_above;
    vec4 y_below;
    vec4 z_above;
    vec4 z_below;
};
struct KilnQuadratic {
    vec4 low;
    vec4 high;
    float last;
};
struct KilnQuadraticModel {
    vec3 middle;
    KilnQuadratic mean;
    KilnQuadratic x_above;
    KilnQuadratic x_below;
    KilnQuadratic y_above;
    KilnQuadratic y_below;
    KilnQuadratic z_above;
    KilnQuadratic z_below;
};

vec4 kiln_halves(uint first, uint second) {
    return vec4(unpackHalf2x16(first), unpackHalf2x16(second));
}

KilnLinearModel kiln_linear_model(uint words[17]) {
    vec4 _e10 = kiln_halves(words[3], words[4]);
    vec4 _e13 = kiln_halves(words[5], words[6]);
    vec4 _e16 = kiln_halves(words[7], words[8]);
    vec4 _e19 = kiln_halves(words[9], words[10]);
    vec4 _e22 = kiln_halves(words[11], words[12]);
    vec4 _e25 = kiln_halves(words[13], words[14]);
    vec4 _e28 = kiln_halves(words[15], words[16]);
    return KilnLinearModel(vec3(uintBitsToFloat(words[0]), uintBitsToFloat(words[1]), uintBitsToFloat(words[2])), _e10, _e13, _e16, _e19, _e22, _e25, _e28);
}

vec3 kiln_clamp(vec3 point, vec3 low, vec3 high) {
    return min(max(point, low), high);
}

vec4 kiln_linear_at(KilnLinearModel model, vec3 point_1) {
    vec3 offset = (point_1 - model.middle);
    return (((model.mean + (offset.x * ((offset.x < 0.0) ? model.x_below : model.x_above))) + (offset.y * ((offset.y < 0.0) ? model.y_below : model.y_above))) + (offset.z * ((offset.z < 0.0) ? model.z_below : model.z_above)));
}

KilnQuadratic kiln_add(KilnQuadratic sum, float factor, KilnQuadratic above, KilnQuadratic below) {
    bool is_below = (factor < 0.0);
    return KilnQuadratic((sum.low + (factor * (is_below ? below.low : above.low))), (sum.high + (factor * (is_below ? below.high : above.high))), (sum.last + (factor * (is_below ? below.last : above.last))));
}

KilnQuadratic kiln_quadratic_at(KilnQuadraticModel model_1, vec3 point_2) {
    vec3 offset_1 = (point_2 - model_1.middle);
    KilnQuadratic _e8 = kiln_add(model_1.mean, offset_1.x, model_1.x_above, model_1.x_below);
    KilnQuadratic _e12 = kiln_add(_e8, offset_1.y, model_1.y_above, model_1.y_below);
    KilnQuadratic _e16 = kiln_add(_e12, offset_1.z, model_1.z_above, model_1.z_below);
    return _e16;
}

float kiln_unit(float value) {
    return min(max(value, 0.0), 1.0);
}

vec4 kiln_linear_harmonics(vec3 normal) {
    return vec4(0.28209478, (0.48860252 * normal.y), (0.48860252 * normal.z), (0.48860252 * normal.x));
}

KilnQuadratic kiln_quadratic_harmonics(vec3 normal_1) {
    vec4 _e2 = kiln_linear_harmonics(normal_1);
    return KilnQuadratic(_e2, vec4((1.0925484 * (normal_1.x * normal_1.y)), (1.0925484 * (normal_1.y * normal_1.z)), (0.31539157 * ((3.0 * (normal_1.z * normal_1.z)) - 1.0)), (1.0925484 * (normal_1.x * normal_1.z))), (0.5462742 * ((normal_1.x * normal_1.x) - (normal_1.y * normal_1.y))));
}

float kiln_ao_linear(vec4 coefficients, vec3 normal_2) {
    vec4 _e2 = kiln_linear_harmonics(normal_2);
    float _e4 = kiln_unit(dot(coefficients, _e2));
    return _e4;
}

float kiln_ao_quadratic(KilnQuadratic coefficients_1, vec3 normal_3) {
    KilnQuadratic _e2 = kiln_quadratic_harmonics(normal_3);
    float linear = dot(coefficients_1.low, _e2.low);
    float _e14 = kiln_unit(((linear + dot(coefficients_1.high, _e2.high)) + (coefficients_1.last * _e2.last)));
    return _e14;
}

vec3 kiln_tree_place(vec3 position, vec3 middle, vec3 half_extent) {
    bvec3 is_flat = lessThanEqual(half_extent, vec3(0.0));
    vec3 size = mix(half_extent, vec3(1.0), is_flat);
    vec3 place_1 = clamp(((position - middle) / size), vec3(-1.0), vec3(1.0));
    return mix(place_1, vec3(0.0), is_flat);
}

float kiln_tree_ao(float local, vec4 numbers, vec3 place) {
    float _e8 = kiln_unit((local * (numbers.x + dot(numbers.yzw, place))));
    return _e8;
}

float kiln_blend(vec4 channels, vec4 weights) {
    float _e3 = kiln_unit(dot(channels, weights));
    return _e3;
}

float kiln_temporal_weight(float dt_secs, float half_time_secs) {
    if (!((half_time_secs > 0.0))) {
        return 1.0;
    }
    if (!((dt_secs > 0.0))) {
        return 0.0;
    }
    return (1.0 - exp2(-(min((dt_secs / half_time_secs), 64.0))));
}

vec4 kiln_temporal_blend(vec4 previous, vec4 now, float weight) {
    return (previous + ((now - previous) * weight));
}

float kiln_remap_gamma(float ao, float gamma) {
    float _e2 = kiln_unit(ao);
    float _e4 = kiln_unit(pow(_e2, gamma));
    return _e4;
}

float kiln_segment(float before, float value_1, vec4 start, vec4 end, bool is_there) {
    bool local_1 = false;
    float _e15 = kiln_unit(((value_1 - start.x) / (end.x - start.x)));
    float along = (start.y + ((end.y - start.y) * _e15));
    if (is_there) {
        local_1 = (value_1 >= start.x);
    } else {
        local_1 = false;
    }
    bool _e23 = local_1;
    return (_e23 ? along : before);
}

float kiln_remap_curve(float ao_1, vec4 points[16], uint count) {
    float result = 0.0;
    float _e3 = kiln_unit(ao_1);
    result = points[0].y;
    float _e7 = result;
    float _e12 = kiln_segment(_e7, _e3, points[0], points[1], (count > 1u));
    result = _e12;
    float _e13 = result;
    float _e18 = kiln_segment(_e13, _e3, points[1], points[2], (count > 2u));
    result = _e18;
    float _e19 = result;
    float _e24 = kiln_segment(_e19, _e3, points[2], points[3], (count > 3u));
    result = _e24;
    float _e25 = result;
    float _e30 = kiln_segment(_e25, _e3, points[3], points[4], (count > 4u));
    result = _e30;
    float _e31 = result;
    float _e36 = kiln_segment(_e31, _e3, points[4], points[5], (count > 5u));
    result = _e36;
    float _e37 = result;
    float _e42 = kiln_segment(_e37, _e3, points[5], points[6], (count > 6u));
    result = _e42;
    float _e43 = result;
    float _e48 = kiln_segment(_e43, _e3, points[6], points[7], (count > 7u));
    result = _e48;
    float _e49 = result;
    float _e54 = kiln_segment(_e49, _e3, points[7], points[8], (count > 8u));
    result = _e54;
    float _e55 = result;
    float _e60 = kiln_segment(_e55, _e3, points[8], points[9], (count > 9u));
    result = _e60;
    float _e61 = result;
    float _e66 = kiln_segment(_e61, _e3, points[9], points[10], (count > 10u));
    result = _e66;
    float _e67 = result;
    float _e72 = kiln_segment(_e67, _e3, points[10], points[11], (count > 11u));
    result = _e72;
    float _e73 = result;
    float _e78 = kiln_segment(_e73, _e3, points[11], points[12], (count > 12u));
    result = _e78;
    float _e79 = result;
    float _e84 = kiln_segment(_e79, _e3, points[12], points[13], (count > 13u));
    result = _e84;
    float _e85 = result;
    float _e90 = kiln_segment(_e85, _e3, points[13], points[14], (count > 14u));
    result = _e90;
    float _e91 = result;
    float _e96 = kiln_segment(_e91, _e3, points[14], points[15], (count > 15u));
    result = _e96;
    float _e97 = result;
    float _e98 = kiln_unit(_e97);
    return _e98;
}

uint kiln_dither(uint x, uint y, uint frame) {
    return (((x * 3242174889u) + (y * 2447445413u)) + (frame * 2654435769u));
}

uint kiln_quantise(float ao_2, uint dither) {
    float _e2 = kiln_unit(ao_2);
    return ((uint(((_e2 * 32505856.0) + 0.5)) + (dither >> 12u)) >> 20u);
}

float kiln_dequantise(uint steps) {
    return (float(min(steps, 31u)) / 31.0);
}
