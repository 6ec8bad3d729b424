//! What happens where there is no device, where it is lost, and where a scene does not fit.

use crate::scenes;
use glam::Vec3;
use kiln_core::Kernel;
use kiln_gpu::{AdapterChoice, AdapterKind, GpuDevice, GpuError, GpuTracer, adapters};
use kiln_trace::{CosineSums, Hit, KernelRates, Ray, TraceError, Tracer};

#[test]
fn the_software_adapter_is_found_and_named() {
    let device = crate::device();
    assert_eq!(device.adapter().kind, AdapterKind::Software);
    assert!(adapters().contains(device.adapter()));
    let lane = device.lane();
    assert!(lane.starts_with("gpu:") && lane.split(':').count() == 3 && lane.contains('+'), "{lane}");
    assert!(device.describe().contains("software"), "{}", device.describe());
    // By a part of its name, and never by itself.
    let name = device.adapter().name[..6].to_uppercase();
    let named = GpuDevice::open(&AdapterChoice::Named(name)).expect("it opens").expect("it is there");
    assert!(named.adapter().name.starts_with(&device.adapter().name[..6]));
    if let Some(real) = GpuDevice::open(&AdapterChoice::Real).expect("it opens") {
        assert!(real.adapter().kind.is_real());
    }
}

#[test]
fn an_unknown_name_is_an_error_that_lists_the_adapters() {
    let error = GpuDevice::open(&AdapterChoice::Named("no such card".to_owned())).expect_err("there is none");
    let found = crate::device().adapter().name.clone();
    assert!(matches!(&error, GpuError::NotFound { wanted, .. } if wanted == "no such card"));
    assert!(error.to_string().contains(&found) && error.to_string().contains("--backend cpu"), "{error}");
}

/// Runs in a process of its own, without any driver.
#[test]
#[ignore = "started by `without_a_driver_there_is_no_adapter`"]
fn child_without_a_driver() {
    assert!(std::env::var_os("VK_DRIVER_FILES").is_some());
    assert_eq!(adapters(), []);
    for choice in [AdapterChoice::Real, AdapterChoice::Software] {
        assert!(GpuDevice::open(&choice).expect("no adapter is no error").is_none());
    }
    println!("no adapter, no panic");
}

#[test]
fn without_a_driver_there_is_no_adapter() {
    let this = std::env::current_exe().expect("a test is a program");
    let output = std::process::Command::new(this)
        .args(["--exact", "faults::child_without_a_driver", "--ignored", "--nocapture"])
        .env("VK_DRIVER_FILES", "/nonexistent.json")
        .env("VK_ICD_FILENAMES", "/nonexistent.json")
        .output()
        .expect("it starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("no adapter, no panic"), "{text}");
}

#[test]
fn a_lost_device_is_an_error_for_good() {
    let device = crate::open_device();
    let scene = &scenes::all()[0];
    let built = scene.build();
    let tracer = GpuTracer::new(device.clone(), &built).expect("the scene fits");
    let samples = scene.samples(100, 16);
    let rates = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0] });
    let mut sums = vec![CosineSums::default(); samples.len()];
    tracer.gather_cosine(&samples, &rates, 16, &mut sums).expect("it traces");
    device.destroy();
    for _ in 0..2 {
        let error = tracer.gather_cosine(&samples, &rates, 16, &mut sums).expect_err("the device is gone");
        assert!(
            matches!(&error, TraceError::DeviceLost { adapter, .. } if *adapter == device.adapter().name),
            "{error}"
        );
        let ray = Ray { origin: Vec3::ZERO, direction: Vec3::X, t_max: 1.0 };
        let error = tracer.trace(&[ray], &mut [Hit::MISS]).expect_err("the device is gone");
        assert!(matches!(error, TraceError::DeviceLost { .. }), "{error}");
    }
    let error = GpuTracer::new(device, &built).expect_err("the device is gone");
    assert!(matches!(error, GpuError::Trace(TraceError::DeviceLost { .. })), "{error}");
}

/// With calls of several threads in flight: each ends, with its results or with the loss, and none gets wrong sums.
#[test]
fn a_device_that_is_lost_between_calls_fails_every_thread() {
    let device = crate::open_device();
    let scene = &scenes::all()[4];
    let tracer = GpuTracer::new(device.clone(), &scene.build()).expect("the scene fits");
    let samples = scene.samples(3000, 16);
    let rates = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0] });
    let gather = || {
        let mut sums = vec![CosineSums::default(); samples.len()];
        tracer.gather_cosine(&samples, &rates, 16, &mut sums).map(|()| sums)
    };
    let expected = gather().expect("it traces");
    let calls = std::sync::atomic::AtomicUsize::new(0);
    let until_lost = || loop {
        match gather() {
            Ok(sums) => assert_eq!(sums, expected),
            Err(error) => return error,
        }
        calls.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    };
    std::thread::scope(|scope| {
        let threads = [(); 3].map(|()| scope.spawn(until_lost));
        while calls.load(std::sync::atomic::Ordering::Relaxed) < 6 {
            std::thread::yield_now();
        }
        device.destroy();
        for thread in threads {
            let error = thread.join().expect("no thread panics");
            assert!(matches!(error, TraceError::DeviceLost { .. }), "{error}");
        }
    });
}

#[test]
fn a_scene_that_does_not_fit_is_an_error_with_numbers() {
    let built = scenes::all()[8].build();
    let error = GpuTracer::with_binding_bytes(crate::device(), &built, 4096).expect_err("it does not fit");
    let GpuError::Trace(TraceError::TooLarge { needed, available, .. }) = error else { panic!("{error}") };
    let whole = GpuTracer::new(crate::device(), &built).expect("the scene fits");
    assert_eq!(needed, whole.memory_bytes());
    assert!(available < needed && available >= 4096);
}
