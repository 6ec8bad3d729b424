//! Names of half-distances, for tables.

use kiln_core::Kernel;
use kiln_runtime::Meta;

/// `2 m`, `300 m`; or the ray distance of plain occlusion.
pub(crate) fn channel_names(kernel: &Kernel) -> Vec<String> {
    match kernel {
        Kernel::Obscurance { half_distances_m } => {
            half_distances_m.iter().map(|d| format!("{d:.4} m")).map(trim).collect()
        }
        Kernel::Occlusion { ray_distance_m } => vec![format!("occlusion to {ray_distance_m} m")],
    }
}

/// What a ray was worth in the bake of a pack.
pub(crate) fn kernel_of(meta: &Meta<'_>) -> Kernel {
    // The number that was meant: the shortest one that is this float.
    let exact = |distance: &f32| distance.to_string().parse().unwrap_or(f64::from(*distance));
    let distances: Vec<f64> = meta.half_distances().iter().map(exact).collect();
    match meta.kernel() {
        kiln_runtime::Kernel::Occlusion => Kernel::Occlusion { ray_distance_m: distances[0] },
        _ => Kernel::Obscurance { half_distances_m: distances },
    }
}

fn trim(text: String) -> String {
    match text.strip_suffix(" m") {
        Some(number) if number.contains('.') => format!("{} m", number.trim_end_matches('0').trim_end_matches('.')),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pack_says_what_its_rays_were_worth() {
        use kiln_runtime::write::{MetaData, PackData, RemapData, write};
        let kernel = |kernel, half_distances: Vec<f32>| {
            let blend = vec![1.0; half_distances.len()];
            let meta = MetaData {
                level_digest: [0; 32],
                version: String::new(),
                origin: [0.0; 3],
                kernel,
                half_distances,
                blend,
                remap: RemapData::None,
            };
            let bytes = write(&PackData::new(meta)).unwrap();
            kernel_of(kiln_runtime::Pack::new(&bytes).unwrap().meta())
        };
        let obscurance = Kernel::Obscurance { half_distances_m: vec![0.04, 300.0] };
        assert_eq!(kernel(kiln_runtime::Kernel::Obscurance, vec![0.04, 300.0]), obscurance);
        let occlusion = |ray_distance_m| Kernel::Occlusion { ray_distance_m };
        assert_eq!(kernel(kiln_runtime::Kernel::Occlusion, vec![1.5]), occlusion(1.5));
        assert_eq!(kernel(kiln_runtime::Kernel::Occlusion, vec![f32::INFINITY]), occlusion(f64::INFINITY));
    }

    #[test]
    fn names_are_short() {
        let kernel = Kernel::Obscurance { half_distances_m: vec![0.025, 2.0, 300.0] };
        assert_eq!(channel_names(&kernel), ["0.025 m", "2 m", "300 m"]);
    }
}
