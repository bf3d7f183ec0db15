//! The programs in use, by identity. Draw thread.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::compile::{Compiled, compile};
use super::heights::heights_source;
use crate::draw::pipelines::key::MAX_PROGRAMS;
use crate::gpu::catch_errors;
use crate::state::Program;

struct Entry {
    /// Weak, so that the application decides when it is dropped; it also keeps the address from being reused.
    program: Weak<Program>,
    /// `None` if it has errors.
    compiled: Option<Compiled>,
}

/// The programs in use. Indices of dropped ones are reused.
#[derive(Default)]
pub(in crate::draw) struct Programs {
    entries: Vec<Option<Entry>>,
    /// By address of the program. Used for look-ups only while drawing, since its order is random.
    index_of: HashMap<usize, u16>,
}

impl Programs {
    /// Returns the index of a program and compiles it at the first call. An invalid program is an error then, and `None`
    /// later.
    pub(in crate::draw) fn ensure(
        &mut self,
        device: &wgpu::Device,
        program: &Arc<Program>,
    ) -> Result<Option<u16>, String> {
        let address = Arc::as_ptr(program).addr();
        if let Some(&index) = self.index_of.get(&address) {
            return Ok(self.get(index).is_some().then_some(index));
        }
        let free = self.entries.iter().position(Option::is_none);
        let index = free.unwrap_or(self.entries.len());
        if index >= MAX_PROGRAMS {
            let name = &program.name;
            return Err(format!("program {name:?} is one more than the {MAX_PROGRAMS} programs that may be in use"));
        }
        let (compiled, error) = catch_errors(device, || compile(device, program));
        let compiled = compiled.and_then(|compiled| error.map_or(Ok(compiled), |error| Err(error.to_string())));
        let (compiled, result) = match compiled {
            Ok(compiled) => (Some(compiled), Ok(Some(index as u16))),
            Err(reason) => (None, Err(format!("program {:?}: {reason}", program.name))),
        };
        self.index_of.insert(address, index as u16);
        let entry = Some(Entry { program: Arc::downgrade(program), compiled });
        match free {
            Some(index) => self.entries[index] = entry,
            None => self.entries.push(entry),
        }
        result
    }

    /// Removes the programs that the application has dropped; returns their indices.
    pub(in crate::draw) fn prune(&mut self) -> Vec<u16> {
        let mut dropped = Vec::new();
        for (index, slot) in (0u16..).zip(&mut self.entries) {
            if slot.take_if(|entry| entry.program.strong_count() == 0).is_some() {
                dropped.push(index);
            }
        }
        if !dropped.is_empty() {
            self.index_of.retain(|_, index| !dropped.contains(index));
        }
        dropped
    }

    /// Creates the module of a program for height tiles, if it has none. Called once for each program.
    pub(in crate::draw) fn ensure_heights(&mut self, device: &wgpu::Device, index: u16) -> Result<(), String> {
        let Some(Some(entry)) = self.entries.get_mut(usize::from(index)) else { return Ok(()) };
        let Some(compiled) = entry.compiled.as_mut().filter(|c| c.heights.is_none()) else { return Ok(()) };
        // The state that is drawn with it holds it.
        let Some(program) = entry.program.upgrade() else { return Ok(()) };
        let source = heights_source(&program.wgsl)
            .map_err(|reason| format!("program {:?} on height tiles: {reason}", program.name))?;
        let source = wgpu::ShaderSource::Wgsl(source.into());
        let descriptor = wgpu::ShaderModuleDescriptor { label: Some(&program.name), source };
        let (module, error) = catch_errors(device, || device.create_shader_module(descriptor));
        compiled.heights = error.is_none().then_some(module);
        error.map_or(Ok(()), |error| Err(format!("program {:?} on height tiles: {error}", program.name)))
    }

    /// Returns the name of a program for error texts.
    pub(in crate::draw) fn name(&self, index: u16) -> Option<String> {
        let entry = self.entries.get(usize::from(index))?.as_ref()?;
        entry.program.upgrade().map(|program| program.name.clone())
    }

    /// Returns a program by index; `None` if it has errors.
    pub(in crate::draw) fn get(&self, index: u16) -> Option<&Compiled> {
        self.entries.get(usize::from(index))?.as_ref()?.compiled.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    const FRAGMENT: &str = "@fragment fn fs_main() -> @location(0) vec4<f32> { return vec4<f32>(1.0); }";

    #[test]
    fn indices_of_dropped_programs_are_reused() {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let vertex = "@vertex fn vs_main(v: MeshVertex) -> @builtin(position) vec4<f32> { return vec4<f32>(1.0); }";
        let program = |wgsl: String| Arc::new(Program { name: "p".into(), wgsl, defines: Vec::new() });
        let whole = || program(format!("{vertex}{FRAGMENT}"));
        let mut programs = Programs::default();
        let [first, second] = [whole(), whole()];
        assert_eq!(programs.ensure(ctx.device(), &first), Ok(Some(0)));
        assert_eq!(programs.ensure(ctx.device(), &second), Ok(Some(1)));
        let broken = program(FRAGMENT.into());
        assert!(programs.ensure(ctx.device(), &broken).is_err());
        assert_eq!(programs.ensure(ctx.device(), &broken), Ok(None));
        assert!(programs.prune().is_empty());
        drop((first, broken));
        assert_eq!(programs.prune(), [0, 2]);
        assert_eq!(programs.index_of.len(), 1);
        assert!(programs.get(0).is_none() && programs.get(1).is_some());
        let third = whole();
        assert_eq!(programs.ensure(ctx.device(), &third), Ok(Some(0)));
        assert_eq!(programs.ensure(ctx.device(), &second), Ok(Some(1)));
    }
}
