// Written from kiln_runtime.wgsl by `cargo xtask shaders`: change that file, and see it for what functions do.
// Needs shader model 5.1.

struct KilnLinearModel {
    float3 middle;
    int _pad1_0;
    float4 mean;
    float4 x_above;
    float4 x_below;
    float4 y_above;
    float4 y_below;
    float4 z_above;
    float4 z_below;
};

struct KilnQuadratic {
    float4 low;
    float4 high;
    float last;
    int _end_pad_0;
    int _end_pad_1;
    int _end_pad_2;
};

struct KilnQuadraticModel {
    float3 middle;
    int _pad1_0;
    KilnQuadratic mean;
    KilnQuadratic x_above;
    KilnQuadratic x_below;
    KilnQuadratic y_above;
    KilnQuadratic y_below;
    KilnQuadratic z_above;
    KilnQuadratic z_below;
};

float4 kiln_halves(uint first, uint second)
{
    return float4(float2(f16tof32(first), f16tof32((first) >> 16)), float2(f16tof32(second), f16tof32((second) >> 16)));
}

KilnLinearModel ConstructKilnLinearModel(float3 arg0, float4 arg1, float4 arg2, float4 arg3, float4 arg4, float4 arg5, float4 arg6, float4 arg7) {
    KilnLinearModel ret = (KilnLinearModel)0;
    ret.middle = arg0;
    ret.mean = arg1;
    ret.x_above = arg2;
    ret.x_below = arg3;
    ret.y_above = arg4;
    ret.y_below = arg5;
    ret.z_above = arg6;
    ret.z_below = arg7;
    return ret;
}

KilnLinearModel kiln_linear_model(uint words[17])
{
    const float4 _e10 = kiln_halves(words[3], words[4]);
    const float4 _e13 = kiln_halves(words[5], words[6]);
    const float4 _e16 = kiln_halves(words[7], words[8]);
    const float4 _e19 = kiln_halves(words[9], words[10]);
    const float4 _e22 = kiln_halves(words[11], words[12]);
    const float4 _e25 = kiln_halves(words[13], words[14]);
    const float4 _e28 = kiln_halves(words[15], words[16]);
    const KilnLinearModel kilnlinearmodel = ConstructKilnLinearModel(float3(asfloat(words[0]), asfloat(words[1]), asfloat(words[2])), _e10, _e13, _e16, _e19, _e22, _e25, _e28);
    return kilnlinearmodel;
}

float3 kiln_clamp(float3 point_, float3 low, float3 high)
{
    return min(max(point_, low), high);
}

float4 kiln_linear_at(KilnLinearModel model, float3 point_1)
{
    float3 offset = (point_1 - model.middle);
    return (((model.mean + (offset.x * ((offset.x < 0.0) ? model.x_below : model.x_above))) + (offset.y * ((offset.y < 0.0) ? model.y_below : model.y_above))) + (offset.z * ((offset.z < 0.0) ? model.z_below : model.z_above)));
}

KilnQuadratic ConstructKilnQuadratic(float4 arg0, float4 arg1, float arg2) {
    KilnQuadratic ret = (KilnQuadratic)0;
    ret.low = arg0;
    ret.high = arg1;
    ret.last = arg2;
    return ret;
}

KilnQuadratic kiln_add(KilnQuadratic sum, float factor, KilnQuadratic above, KilnQuadratic below)
{
    bool is_below = (factor < 0.0);
    const KilnQuadratic kilnquadratic = ConstructKilnQuadratic((sum.low + (factor * (is_below ? below.low : above.low))), (sum.high + (factor * (is_below ? below.high : above.high))), (sum.last + (factor * (is_below ? below.last : above.last))));
    return kilnquadratic;
}

KilnQuadratic kiln_quadratic_at(KilnQuadraticModel model_1, float3 point_2)
{
    float3 offset_1 = (point_2 - model_1.middle);
    const KilnQuadratic _e8 = kiln_add(model_1.mean, offset_1.x, model_1.x_above, model_1.x_below);
    const KilnQuadratic _e12 = kiln_add(_e8, offset_1.y, model_1.y_above, model_1.y_below);
    const KilnQuadratic _e16 = kiln_add(_e12, offset_1.z, model_1.z_above, model_1.z_below);
    const KilnQuadratic kilnquadratic_1 = _e16;
    return kilnquadratic_1;
}

float kiln_unit(float value)
{
    return min(max(value, 0.0), 1.0);
}

float4 kiln_linear_harmonics(float3 normal)
{
    return float4(0.28209478, (0.48860252 * normal.y), (0.48860252 * normal.z), (0.48860252 * normal.x));
}

KilnQuadratic kiln_quadratic_harmonics(float3 normal_1)
{
    const float4 _e2 = kiln_linear_harmonics(normal_1);
    const KilnQuadratic kilnquadratic_2 = ConstructKilnQuadratic(_e2, float4((1.0925484 * (normal_1.x * normal_1.y)), (1.0925484 * (normal_1.y * normal_1.z)), (0.31539157 * ((3.0 * (normal_1.z * normal_1.z)) - 1.0)), (1.0925484 * (normal_1.x * normal_1.z))), (0.5462742 * ((normal_1.x * normal_1.x) - (normal_1.y * normal_1.y))));
    return kilnquadratic_2;
}

float kiln_ao_linear(float4 coefficients, float3 normal_2)
{
    const float4 _e2 = kiln_linear_harmonics(normal_2);
    const float _e4 = kiln_unit(dot(coefficients, _e2));
    return _e4;
}

float kiln_ao_quadratic(KilnQuadratic coefficients_1, float3 normal_3)
{
    const KilnQuadratic _e2 = kiln_quadratic_harmonics(normal_3);
    float linear_ = dot(coefficients_1.low, _e2.low);
    const float _e14 = kiln_unit(((linear_ + dot(coefficients_1.high, _e2.high)) + (coefficients_1.last * _e2.last)));
    return _e14;
}

float3 kiln_tree_place(float3 position, float3 middle, float3 half_extent)
{
    bool3 is_flat = (half_extent <= (0.0).xxx);
    float3 size = (is_flat ? (1.0).xxx : half_extent);
    float3 place_1 = clamp(((position - middle) / size), (-1.0).xxx, (1.0).xxx);
    return (is_flat ? (0.0).xxx : place_1);
}

float kiln_tree_ao(float local, float4 numbers, float3 place)
{
    const float _e8 = kiln_unit((local * (numbers.x + dot(numbers.yzw, place))));
    return _e8;
}

float kiln_blend(float4 channels, float4 weights)
{
    const float _e3 = kiln_unit(dot(channels, weights));
    return _e3;
}

float kiln_temporal_weight(float dt_secs, float half_time_secs)
{
    if (!((half_time_secs > 0.0))) {
        return 1.0;
    }
    if (!((dt_secs > 0.0))) {
        return 0.0;
    }
    return (1.0 - exp2(-(min((dt_secs / half_time_secs), 64.0))));
}

float4 kiln_temporal_blend(float4 previous, float4 now, float weight)
{
    return (previous + ((now - previous) * weight));
}

float kiln_remap_gamma(float ao, float gamma)
{
    const float _e2 = kiln_unit(ao);
    const float _e4 = kiln_unit(pow(_e2, gamma));
    return _e4;
}

float kiln_segment(float before, float value_1, float4 start, float4 end, bool is_there)
{
    bool local_1 = (bool)0;

    const float _e15 = kiln_unit(((value_1 - start.x) / (end.x - start.x)));
    float along = (start.y + ((end.y - start.y) * _e15));
    if (is_there) {
        local_1 = (value_1 >= start.x);
    } else {
        local_1 = false;
    }
    bool _e23 = local_1;
    return (_e23 ? along : before);
}

float kiln_remap_curve(float ao_1, float4 points[16], uint count)
{
    float result = (float)0;

    const float _e3 = kiln_unit(ao_1);
    result = points[0].y;
    float _e7 = result;
    const float _e12 = kiln_segment(_e7, _e3, points[0], points[1], (count > 1u));
    result = _e12;
    float _e13 = result;
    const float _e18 = kiln_segment(_e13, _e3, points[1], points[2], (count > 2u));
    result = _e18;
    float _e19 = result;
    const float _e24 = kiln_segment(_e19, _e3, points[2], points[3], (count > 3u));
    result = _e24;
    float _e25 = result;
    const float _e30 = kiln_segment(_e25, _e3, points[3], points[4], (count > 4u));
    result = _e30;
    float _e31 = result;
    const float _e36 = kiln_segment(_e31, _e3, points[4], points[5], (count > 5u));
    result = _e36;
    float _e37 = result;
    const float _e42 = kiln_segment(_e37, _e3, points[5], points[6], (count > 6u));
    result = _e42;
    float _e43 = result;
    const float _e48 = kiln_segment(_e43, _e3, points[6], points[7], (count > 7u));
    result = _e48;
    float _e49 = result;
    const float _e54 = kiln_segment(_e49, _e3, points[7], points[8], (count > 8u));
    result = _e54;
    float _e55 = result;
    const float _e60 = kiln_segment(_e55, _e3, points[8], points[9], (count > 9u));
    result = _e60;
    float _e61 = result;
    const float _e66 = kiln_segment(_e61, _e3, points[9], points[10], (count > 10u));
    result = _e66;
    float _e67 = result;
    const float _e72 = kiln_segment(_e67, _e3, points[10], points[11], (count > 11u));
    result = _e72;
    float _e73 = result;
    const float _e78 = kiln_segment(_e73, _e3, points[11], points[12], (count > 12u));
    result = _e78;
    float _e79 = result;
    const float _e84 = kiln_segment(_e79, _e3, points[12], points[13], (count > 13u));
    result = _e84;
    float _e85 = result;
    const float _e90 = kiln_segment(_e85, _e3, points[13], points[14], (count > 14u));
    result = _e90;
    float _e91 = result;
    const float _e96 = kiln_segment(_e91, _e3, points[14], points[15], (count > 15u));
    result = _e96;
    float _e97 = result;
    const float _e98 = kiln_unit(_e97);
    return _e98;
}

uint kiln_dither(uint x, uint y, uint frame)
{
    return (((x * 3242174889u) + (y * 2447445413u)) + (frame * 2654435769u));
}

uint naga_f2u32(float value) {
    return uint(clamp(value, 0.0, 4294967000.0));
}

uint kiln_quantise(float ao_2, uint dither)
{
    const float _e2 = kiln_unit(ao_2);
    return ((naga_f2u32(((_e2 * 32505856.0) + 0.5)) + (dither >> 12u)) >> 20u);
}

float kiln_dequantise(uint steps)
{
    return (float(min(steps, 31u)) / 31.0);
}
