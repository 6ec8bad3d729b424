//! Against the processor's tracer.

use super::*;

/// Single rays: values within 4 of 65,536 but for one ray in 500, on which rounding decides whether a face is hit or crossed.
#[test]
fn rays_are_worth_what_they_are_on_the_processor() {
    let kernels = [
        obscurance(&[1.5]),
        obscurance(&[0.4, 9.0]),
        obscurance(&[0.2, 1.0, 5.0, 300.0]),
        occlusion(),
        KernelRates::new(&Kernel::Occlusion { ray_distance_m: 1.2 }),
        // Rays without end.
        KernelRates { t_max: f32::MAX, ..obscurance(&[1.0, 1e-3]) },
    ];
    for mode in BOTH {
        for (seed, kernel) in kernels.iter().enumerate() {
            let mut numbers = Numbers(seed as u64 + 100);
            let things = things(&mut numbers, [3, 6, 12, 40, 90, 60][seed]);
            let still = kiln_trace::SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
            let opaque = TestScene::new("soup", &soup(&mut numbers, 3 * seed), vec![still]);
            let built = scene(&opaque, &things, mode);
            let (cpu, gpu) = (CpuTracer::new(Arc::clone(&built)), on(crate::device(), &built));
            let samples = samples(&mut numbers, 8192);
            let (c, g) = (gather(&cpu, &samples, kernel, 1), gather(&gpu, &samples, kernel, 1));
            let differs = |(c, g): &(&CosineSums, &CosineSums)| {
                c.rays != g.rays || c.values.iter().zip(g.values).any(|(c, g)| c.abs_diff(g) > 4)
            };
            let far = c.iter().zip(&g).filter(differs).count();
            assert!(far <= samples.len() / 500, "{mode:?} {seed}: {far} of {} rays", samples.len());
            println!("{mode:?} {seed}: {far} of {} rays differ", samples.len());
            let dimmed = c.iter().filter(|sums| sums.values[0] > 0 && sums.values[0] < 60_000).count();
            assert!(dimmed > samples.len() / 80, "{mode:?} {seed}: only {dimmed} rays go through anything");
            let bias: f64 = c.iter().zip(&g).map(|(c, g)| f64::from(c.values[0]) - f64::from(g.values[0])).sum();
            assert!((bias / (65536.0 * samples.len() as f64)).abs() < 2e-4, "{mode:?} {seed}: biased by {bias}");
        }
    }
}

/// Whole samples and spheres: 99.5 % within 2e-3, all within 4/N, as without foliage.
#[test]
fn sums_are_those_of_the_processor() {
    for mode in BOTH {
        let mut numbers = Numbers(7);
        let things = things(&mut numbers, 60);
        let opaque = &scenes::all()[3];
        let built = scene(opaque, &things, mode);
        let (cpu, gpu) = (CpuTracer::new(Arc::clone(&built)), on(crate::device(), &built));
        let kernel = obscurance(&[2.0, 300.0]);
        for (rays, samples) in [(32, opaque.samples(2048, 32)), (256, samples(&mut numbers, 99))] {
            let (c, g) = (gather(&cpu, &samples, &kernel, rays), gather(&gpu, &samples, &kernel, rays));
            let error = |(c, g): (&CosineSums, &CosineSums)| {
                [0, 1].map(|channel| (c.ao(channel) - g.ao(channel)).abs()).into_iter().fold(0.0, f64::max)
            };
            let errors: Vec<f64> = c.iter().zip(&g).map(error).collect();
            assert!(errors.iter().all(|error| *error <= 4.0 / f64::from(rays)), "{mode:?}: {errors:?}");
            let far = errors.iter().filter(|error| **error > 2e-3).count();
            assert!(far <= samples.len() / 200, "{mode:?}: {far} of {}", samples.len());
        }
        let point = |_| SpherePoint { origin: numbers.point() * 3.0, scramble: numbers.scramble() };
        let points: Vec<SpherePoint> = (0..200).map(point).collect();
        let [c, g] = [&cpu as &dyn Tracer, &gpu].map(|tracer| {
            let mut sums = vec![SphereSums::default(); points.len()];
            tracer.gather_sphere(&points, &kernel, 256, &mut sums).expect("it traces");
            sums
        });
        let mut far = 0;
        for (c, g) in c.iter().zip(&g) {
            assert_eq!((c.basis, c.rays), (g.basis, g.rays));
            for channel in 0..2 {
                let pairs = c.coefficients(channel).into_iter().zip(g.coefficients(channel));
                let error = pairs.map(|(c, g)| (c - g).abs()).fold(0.0, f64::max);
                // A ray counts for 4 pi / 256 times a function that is at most 0.63.
                assert!(error < 4.0 * 0.031, "{mode:?}: {error}");
                far += usize::from(error > 5e-3);
            }
        }
        assert!(far <= points.len() * 2 / 100, "{mode:?}: {far}");
    }
}
