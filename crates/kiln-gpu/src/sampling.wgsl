// Directions: Owen-scrambled Sobol points, the cells of the unit square, and the cosine map.
// Keep in sync with kiln-trace's sobol.rs and directions.rs: integers are equal bit for bit, floats to 4 ULP.

// How the rays of a sample are dealt to cones. Keep in sync with `Cones` in sampling.rs.
struct Cones {
    // The unit square has 2^(column_bits + row_bits) cells.
    column_bits: u32,
    row_bits: u32,
    // Each sample has 2^ray_bits rays in each cell.
    ray_bits: u32,
    padding: u32,
}

// A permutation in which every output bit depends only on input bits at or below it.
fn laine_karras(value: u32, seed: u32) -> u32 {
    var x = value;
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    return x ^ (x * 0x53a22864u);
}

// Low bits of the number whose permutation has the given bits, one of every two of `bits`, the lowest first.
fn laine_karras_inverse(bits: u32, count: u32, seed: u32) -> u32 {
    var x = 0u;
    for (var i = 0u; i < count; i++) {
        let differs = ((laine_karras(x, seed) >> i) ^ (bits >> (2u * i))) & 1u;
        x |= differs << i;
    }
    return x;
}

// The polynomial p(X) over GF(2), its coefficients the bits of p, becomes p(X + 1); its own inverse. Of an index it
// gives the second dimension of the Sobol sequence, in reversed bits.
fn shift_polynomial(p: u32) -> u32 {
    var x = p;
    x ^= x >> 16u;
    x ^= (x & 0xff00ff00u) >> 8u;
    x ^= (x & 0xf0f0f0f0u) >> 4u;
    x ^= (x & 0xccccccccu) >> 2u;
    return x ^ ((x & 0xaaaaaaaau) >> 1u);
}

fn sobol_point(index: u32, scramble: vec2<u32>) -> vec2<f32> {
    let x = reverseBits(laine_karras(index, scramble.x));
    let y = reverseBits(laine_karras(shift_polynomial(index), scramble.y));
    return vec2<f32>(vec2<u32>(x, y) >> vec2(8u)) * (1f / 16777216f);
}

// Index of a sample's ray in a cell; sampling.rs derives it. `ray` is below 2^ray_bits.
fn index_in_cell(cones: Cones, first_index: u32, cell: u32, ray: u32, scramble: vec2<u32>) -> u32 {
    // Bits of the cell from the coarsest split to the finest, columns and rows in turn.
    let bits = (reverseBits(cell) >> 1u) >> (31u - cones.column_bits - cones.row_bits);
    let column = laine_karras_inverse(bits, cones.column_bits, scramble.x);
    let row = laine_karras_inverse(bits >> 1u, cones.row_bits, scramble.y);
    let known = first_index | column | (ray << (cones.column_bits + cones.row_bits));
    // Solve (1 + X)^column_bits m(1 + X) = row - known(1 + X) mod X^row_bits; (1 + X)^8 = 1 as row_bits is at most 8.
    var rest = row ^ shift_polynomial(known);
    let power = (8u - cones.column_bits) & 7u;
    rest ^= select(0u, rest << 1u, (power & 1u) != 0u);
    rest ^= select(0u, rest << 2u, (power & 2u) != 0u);
    rest ^= select(0u, rest << 4u, (power & 4u) != 0u);
    let solved = shift_polynomial(rest & ((1u << cones.row_bits) - 1u));
    return known | (solved << cones.column_bits);
}

struct Basis {
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
}

fn orthonormal_basis(n: vec3<f32>) -> Basis {
    let side = select(-1f, 1f, n.z >= 0f);
    let a = -1f / (side + n.z);
    let b = n.x * n.y * a;
    return Basis(
        vec3(1f + side * n.x * n.x * a, side * b, -side * n.x),
        vec3(b, side + n.y * n.y * a, -n.y),
    );
}

// Sine and cosine for |x| at most pi/4.
fn sin_cos_quarter(x: f32) -> vec2<f32> {
    let s = x * x;
    let sine = x * (1f + s * (-1f / 6f + s * (1f / 120f + s * (-1f / 5040f))));
    let cosine = 1f + s * (-0.5f + s * (1f / 24f + s * (-1f / 720f + s * (1f / 40320f))));
    return vec2(sine, cosine);
}

fn cosine_about_z(point: vec2<f32>) -> vec3<f32> {
    let ab = 2f * point - vec2(1f);
    let is_wide = abs(ab.x) > abs(ab.y);
    let radius = select(ab.y, ab.x, is_wide);
    let other = select(ab.x, ab.y, is_wide);
    // At the centre both are 0.
    let ratio = other / select(radius, 1f, radius == 0f);
    let polar = radius * sin_cos_quarter(0.785398163397448f * ratio);
    let disk = select(polar.xy, polar.yx, is_wide);
    return vec3(disk, sqrt(max(1f - radius * radius, 0f)));
}

fn cosine_direction(point: vec2<f32>, normal: vec3<f32>, basis: Basis) -> vec3<f32> {
    let local = cosine_about_z(point);
    return basis.tangent * local.x + basis.bitangent * local.y + normal * local.z;
}
