//! Allocations are attributed to the innermost crate of their call stack: Terrane, or wgpu.

use std::collections::HashMap;

/// Returns the call stacks of the allocations that Terrane made in `work`, and the number that wgpu made.
pub fn allocations(work: impl FnOnce()) -> (Vec<String>, usize) {
    let traces = crate::recorded(work);
    // Resolving names takes milliseconds, so each address is resolved once.
    let mut names: HashMap<usize, Vec<String>> = HashMap::new();
    let (mut own, mut wgpu) = (Vec::new(), 0);
    for trace in traces {
        let mut calls = Vec::new();
        for ip in trace {
            let of_address = names.entry(ip).or_insert_with(|| {
                let mut found = Vec::new();
                backtrace::resolve(ip as *mut _, |symbol| {
                    let file = symbol.filename().map_or_else(String::new, |f| f.display().to_string());
                    found.push(format!("{} at {file}", symbol.name().map_or_else(String::new, |n| n.to_string())));
                });
                found
            });
            calls.extend_from_slice(of_address);
        }
        // Without debug information only whole names are known; Terrane's own code has file names.
        let own_sources = concat!(env!("CARGO_MANIFEST_DIR"), "/src/");
        let is_own = |c: &str| c.contains(own_sources) || c.contains(" at src/") || c.contains(" at ./src/");
        let innermost = calls.iter().find(|c| c.contains("wgpu") || is_own(c));
        if innermost.is_some_and(|c| !is_own(c)) {
            wgpu += 1;
        } else {
            own.push(calls.join("\n"));
        }
    }
    (own, wgpu)
}
