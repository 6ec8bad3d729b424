//! Names of half-distances, for tables.

use kiln_core::Kernel;

/// `2 m`, `300 m`; or the ray distance of plain occlusion.
pub(crate) fn channel_names(kernel: &Kernel) -> Vec<String> {
    match kernel {
        Kernel::Obscurance { half_distances_m } => {
            half_distances_m.iter().map(|d| format!("{d:.4} m")).map(trim).collect()
        }
        Kernel::Occlusion { ray_distance_m } => vec![format!("occlusion to {ray_distance_m} m")],
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
    fn names_are_short() {
        let kernel = Kernel::Obscurance { half_distances_m: vec![0.025, 2.0, 300.0] };
        assert_eq!(channel_names(&kernel), ["0.025 m", "2 m", "300 m"]);
    }
}
