//! Which threads run, and on which cores: the environment variable, and processor affinity read back from the system.

use std::process::Command;
use std::sync::{Arc, Mutex};

use kit::process::{runs_alone, test_name};
use kit::tile_sets::small_set;
use terrane::gpu::AdapterChoice;
use terrane::scene::{Node, Page};
use terrane::viewer::{THREADING_VARIABLE, ThreadingModel, Viewer, ViewerConfig, ViewerError};

fn config(threading: ThreadingModel, cpu_affinity: bool) -> ViewerConfig {
    ViewerConfig {
        size_px: [32, 16],
        threading,
        cpu_affinity,
        adapter: AdapterChoice::Noop,
        validation: false,
        ..ViewerConfig::default()
    }
}

/// Run by the test below with the variable in its environment.
#[test]
#[ignore = "needs the variable in its environment: the other test sets it"]
fn in_this_environment() {
    match Viewer::new_offscreen(&config(ThreadingModel::AutomaticSelection, false)) {
        Ok(mut viewer) => {
            viewer.frame().unwrap();
            println!("runs {}", viewer.composite().threading_model());
        }
        Err(error) => {
            assert!(matches!(error, ViewerError::Setting(_)), "{error:?}");
            println!("error {error}");
        }
    }
    let explicit = Viewer::new_offscreen(&config(ThreadingModel::SingleThreaded, false)).unwrap();
    assert_eq!(explicit.composite().threading_model(), ThreadingModel::SingleThreaded, "the setting takes precedence");
}

#[test]
fn environment_variable_names_the_model() {
    let with = |value: &str| {
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", &test_name(module_path!(), "in_this_environment"), "--ignored", "--nocapture"])
            .env(THREADING_VARIABLE, value)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
        said
    };
    for model in ThreadingModel::ALL {
        let said = with(model.name());
        assert!(said.contains(&format!("runs {model}")), "{model}: {said}");
    }
    let wrong = with("TwoThreads");
    assert!(wrong.contains(&format!("error {THREADING_VARIABLE}: `TwoThreads` is none of")), "{wrong}");
}

/// The masks that operations have read, each with the name of its object.
type Masks = Arc<Mutex<Vec<(&'static str, Vec<usize>)>>>;

/// Returns the numbers of the cores that the calling thread may run on.
fn mask() -> Vec<usize> {
    core_affinity::get_core_ids().unwrap_or_default().into_iter().map(|core| core.id).collect()
}

/// Returns the names and the masks of the threads of this process whose names start with a prefix.
#[cfg(target_os = "linux")]
fn masks_of(prefix: &str) -> Vec<(String, String)> {
    let threads = std::fs::read_dir("/proc/self/task").unwrap().filter_map(|thread| {
        let folder = thread.ok()?.path();
        let status = std::fs::read_to_string(folder.join("status")).ok()?;
        let field = |name: &str| status.lines().find_map(|line| line.strip_prefix(name)).map(|v| v.trim().to_owned());
        Some((field("Name:")?, field("Cpus_allowed_list:")?))
    });
    threads.filter(|(name, _)| name.starts_with(prefix)).collect()
}

/// A pinned thread cannot be let go again, so the test has a separate process.
#[cfg(target_os = "linux")]
#[test]
fn single_threaded_model_pins_main_thread_and_pagers_to_the_first_two_cores() {
    if runs_alone(module_path!(), "single_threaded_model_pins_main_thread_and_pagers_to_the_first_two_cores") {
        return;
    }
    let cores = mask();
    if cores.len() < 2 {
        return println!("skipped: the process has one core");
    }
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut config = config(ThreadingModel::SingleThreaded, true);
    // Threads without work are pinned later.
    (config.pager.file_threads, config.pager.decode_threads) = (1, 1);
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.load(&set).unwrap();
    assert_eq!(mask(), cores, "nothing is pinned before the first frame");
    for _ in 0..2000 {
        viewer.frame().unwrap();
        if viewer.is_settled() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(viewer.is_settled() && viewer.pager().unwrap().stats().merged > 0);
    assert_eq!(mask(), cores[..1]);
    for prefix in ["pager-file", "pager-decode"] {
        let found = masks_of(prefix);
        assert!(!found.is_empty() && found.iter().all(|(_, mask)| *mask == cores[1].to_string()), "{found:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn threads_of_the_model_are_pinned_if_affinity_is_on() {
    let cores = mask();
    if cores.len() < 2 {
        return println!("skipped: the process has one core");
    }
    for is_on in [false, true] {
        let threading = ThreadingModel::CullThreadPerCameraDrawThreadPerContext;
        let mut viewer = Viewer::new_offscreen(&config(threading, is_on)).unwrap();
        viewer.add_root(Page::from_node(Node::group(vec![])).unwrap()).unwrap();
        let masks = Masks::default();
        let (drawn, culled) = (masks.clone(), masks.clone());
        let context = viewer.context();
        let of_context = viewer.composite().context_operations(context).unwrap();
        of_context.add_fn("mask", false, move |_| drawn.lock().unwrap().push(("draw", mask())));
        let of_camera = viewer.composite().camera_operations(viewer.view_id(), None).unwrap().unwrap();
        of_camera.add_fn("mask", false, move |_| culled.lock().unwrap().push(("cull", mask())));
        viewer.frame().unwrap();
        viewer.finish().unwrap();
        let mut masks = std::mem::take(&mut *masks.lock().unwrap());
        masks.sort_unstable();
        // The contexts come first, in turn.
        let spare = &cores[1..];
        let expected = |place: usize| if is_on { vec![spare[place % spare.len()]] } else { cores.clone() };
        assert_eq!(masks, [("cull", expected(1)), ("draw", expected(0))], "affinity {is_on}");
        assert_eq!(mask(), cores, "the main thread is not pinned");
    }
}
