//! `docs/batch/slurm.sh` under Slurm, on this machine alone. Skipped where slurmctld, slurmd and munged are not installed, or without
//! root.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::files::files_below;
use crate::runs::updates::hills;
use terrane_data_gen::{Color, GenArgs, run};

/// Daemons that are killed at the end.
struct Daemons(Vec<Child>);

impl Drop for Daemons {
    fn drop(&mut self) {
        for daemon in &mut self.0 {
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}

fn program(name: &str) -> Option<PathBuf> {
    let folders = ["/usr/sbin", "/usr/bin", "/usr/local/sbin", "/usr/local/bin"];
    folders.iter().map(|folder| Path::new(folder).join(name)).find(|path| path.is_file())
}

fn free_port() -> u16 {
    std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port()
}

fn write_program(path: &Path, text: &str) {
    fs::write(path, text).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
}

/// Starts Slurm with one node, and returns the path of its configuration.
fn start(folder: &Path, [munged, slurmctld, slurmd]: [PathBuf; 3]) -> (Daemons, PathBuf) {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap().trim().to_owned();
    let at = |name: &str| folder.join(name).display().to_string();
    fs::write(at("key"), (0..128u8).collect::<Vec<_>>()).unwrap();
    fs::set_permissions(at("key"), fs::Permissions::from_mode(0o600)).unwrap();
    let log = |name: &str| Stdio::from(fs::File::create(at(name)).unwrap());
    let options = ["key-file", "socket", "pid-file", "log-file", "seed-file"].map(|option| {
        let file = if option == "key-file" { "key".to_owned() } else { format!("munge-{option}") };
        format!("--{option}={}", at(&file))
    });
    let mut munge = Command::new(munged);
    munge.args(["--foreground", "--force"]).args(options).stdout(Stdio::null()).stderr(log("munged.log"));
    let mut daemons = Daemons(vec![munge.spawn().unwrap()]);
    for name in ["state", "spool"] {
        fs::create_dir(at(name)).unwrap();
    }
    let configuration = format!(
        "ClusterName=terrane\nSlurmctldHost={host}(127.0.0.1)\nAuthInfo=socket={socket}\nSlurmUser=root\n\
         SlurmctldPort={}\nSlurmdPort={}\nStateSaveLocation={state}\nSlurmdSpoolDir={spool}\n\
         SlurmctldPidFile={folder}/ctld.pid\nSlurmdPidFile={folder}/d.pid\nProctrackType=proctrack/linuxproc\n\
         TaskPlugin=task/none\nReturnToService=2\nMpiDefault=none\nSchedulerParameters=sched_interval=2\n\
         NodeName={host} NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN\n\
         PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP OverSubscribe=FORCE:2\n",
        free_port(),
        free_port(),
        socket = at("munge-socket"),
        state = at("state"),
        spool = at("spool"),
        folder = folder.display(),
    );
    let path = folder.join("slurm.conf");
    fs::write(&path, configuration).unwrap();
    wait("munge's socket", || Path::new(&at("munge-socket")).exists());
    for (program, name) in [(slurmctld, "slurmctld.log"), (slurmd, "slurmd.log")] {
        let mut daemon = Command::new(program);
        let daemon = daemon.arg("-D").env("SLURM_CONF", &path).stdout(Stdio::null()).stderr(log(name));
        daemons.0.push(daemon.spawn().unwrap());
    }
    (daemons, path)
}

fn wait(what: &str, mut is_done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_done() {
        assert!(start.elapsed() < Duration::from_secs(240), "no {what} within 240 s");
        std::thread::sleep(Duration::from_millis(200));
    }
}

#[test]
fn shards_are_made_by_jobs_and_made_again_if_they_fail() {
    let programs = ["munged", "slurmctld", "slurmd"].map(program);
    let is_root = Command::new("id").arg("-u").output().is_ok_and(|id| id.stdout == b"0\n");
    let (true, [Some(munged), Some(slurmctld), Some(slurmd)]) = (is_root, programs) else {
        eprintln!("SKIPPED: Slurm and munge are not installed, or the test does not run as root");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (_daemons, configuration) = start(folder.path(), [munged, slurmctld, slurmd]);
    let dem =
        vec![hills(folder.path(), "a.tif", [7.0, 46.0], 12, 1), hills(folder.path(), "b.tif", [7.4, 46.4], 12, 2)];
    let whole = GenArgs { dem, levels: Some(7), color: Color::None, ..GenArgs::new(folder.path().join("whole")) };
    run(&whole).unwrap();
    // The second shard fails once.
    let flaky = folder.path().join("flaky");
    let (generator, mark) = (env!("CARGO_BIN_EXE_terrane-gen"), folder.path().join("failed"));
    let mark = mark.display();
    write_program(
        &flaky,
        &format!(
            "#!/bin/sh\ncase \"$*\" in *--shard\\ 2/*) [ -e {mark} ] || {{ touch {mark}; exit 1; }};; esac\nexec {generator} \"$@\"\n"
        ),
    );
    let out = folder.path().join("set");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/batch/slurm.sh");
    let submit = || {
        let mut command = Command::new("sh");
        command.arg(&script).arg("3").arg(&out).args(["--levels", "7", "--color", "none", "--dem"]).args(&whole.dem);
        command.env("SLURM_CONF", &configuration).env("TERRANE_GEN", &flaky).output().unwrap()
    };
    // The controller answers some seconds after its start.
    let mut last = String::new();
    wait("controller", || {
        let output = submit();
        last = String::from_utf8_lossy(&output.stderr).into_owned();
        output.status.success()
    });
    wait("merged set", || out.join("tileset.json").is_file());
    assert!(Path::new(&mark.to_string()).exists(), "the second shard has failed once; {last}");
    assert!(files_below(&out) == files_below(&whole.out));
}
