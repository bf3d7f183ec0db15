//! Applies the events of the plan before a frame.

use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use glam::{DMat4, DVec3};
use terrane::viewer::{AnimationPath, ControlPoint, Slave, ViewId};

use super::flight::{Flight, time_s, world_from_eye};
use super::plan::{Event, MAX_CONTEXTS, MAX_SCENES, MAX_VIEWS};

/// The number of frames between points of an announced path.
const FRAMES_PER_POINT: usize = 4;

impl Flight<'_> {
    /// Applies one event. Its numbers choose among the objects that exist now.
    pub(super) fn apply(&mut self, event: Event) -> Result<()> {
        let (scenes, scene_count) = (self.scenes.clone(), self.scenes.len());
        let at = |list: usize, any: usize| any % list.max(1);
        match event {
            Event::Model(model) => self.viewer()?.set_threading_model(model)?,
            Event::StopThreads => self.viewer()?.stop_threading()?,
            Event::Resize { context, size_px } => {
                let context = self.contexts[at(self.contexts.len(), context)];
                self.viewer()?.resize_context(context, size_px)?;
            }
            Event::OpenContext if self.contexts.len() < MAX_CONTEXTS => {
                let context = self.context()?;
                let opened = self.viewer()?.open_context(context)?;
                self.contexts.push(opened);
            }
            // The first context stays open, because its images are checked.
            Event::CloseContext(any) if self.contexts.len() > 1 => {
                let number = 1 + at(self.contexts.len() - 1, any);
                self.close_context(number)?;
            }
            Event::AddView { context, scene, part } if self.views.len() < MAX_VIEWS => {
                self.add_view(scene, context, part)?;
            }
            Event::RemoveView(any) if self.views.len() > 1 => {
                let view = self.views[1 + at(self.views.len() - 1, any)].0;
                self.remove_view(view)?;
            }
            Event::AddSlave { view, context, shift } if self.slaves.len() < MAX_VIEWS => {
                let view = self.views[at(self.views.len(), view)].0;
                let context = self.contexts[at(self.contexts.len(), context)];
                let offset = DMat4::from_translation(DVec3::new(shift, 0.0, 0.0));
                let slave = Slave { projection_offset: offset, ..Slave::new(context) };
                let id = self.viewer()?.add_slave(view, slave)?;
                self.slaves.push((view, id, context));
            }
            Event::RemoveSlave(any) if !self.slaves.is_empty() => {
                let (view, slave, _) = self.slaves.remove(at(self.slaves.len(), any));
                ensure!(self.viewer()?.remove_slave(view, slave)?, "a slave camera was not found");
            }
            Event::Pause { scene, is_paused } => {
                if let Some(pager) = self.viewer()?.pager_mut(scenes[at(scene_count, scene)])? {
                    pager.set_paused(is_paused);
                }
            }
            Event::TakeRequests { scene, takes } => {
                if let Some(pager) = self.viewer()?.pager_mut(scenes[at(scene_count, scene)])? {
                    pager.set_takes_requests(takes);
                }
            }
            Event::Clear(scene) => self.clear_scene(at(scene_count, scene))?,
            Event::Sse { view, px } => {
                let view = self.views[at(self.views.len(), view)].0;
                self.viewer()?.view_mut(view)?.camera.settings.max_sse_px = px;
            }
            Event::Announce { view, path_of } => {
                let number = at(self.views.len(), view);
                self.announce(number, path_of)?;
            }
            Event::Withdraw(view) => {
                let view = self.views[at(self.views.len(), view)].0;
                self.viewer()?.view_mut(view)?.announced = None;
            }
            Event::LoadProxy(any) => {
                if let (Some(proxies), Some(viewer)) = (&mut self.proxies, &mut self.viewer) {
                    proxies.load(viewer, any)?;
                }
            }
            // The first scene stays, because it has the proxies, the sign, and the view whose images are checked.
            Event::RemoveScene if self.scenes.len() > 1 => self.remove_scene(1)?,
            Event::AddScene if self.scenes.len() < MAX_SCENES => self.add_scene_without_faults()?,
            Event::Sleep(ms) => std::thread::sleep(Duration::from_millis(ms)),
            Event::Finish => self.viewer()?.finish()?,
            Event::OpenContext
            | Event::CloseContext(_)
            | Event::AddView { .. }
            | Event::RemoveView(_)
            | Event::AddSlave { .. }
            | Event::RemoveSlave(_)
            | Event::RemoveScene
            | Event::AddScene => {}
        }
        Ok(())
    }

    /// Closes a context with the views whose master camera is in it.
    fn close_context(&mut self, number: usize) -> Result<()> {
        let closed = self.contexts.remove(number);
        ensure!(self.viewer()?.close_context(closed)?, "an open context was not found");
        self.slaves.retain(|(_, _, context)| *context != closed);
        for (view, context) in self.views.clone() {
            if context == closed {
                self.remove_view(view)?;
            }
        }
        Ok(())
    }

    /// Removes a view with its slaves.
    fn remove_view(&mut self, view: ViewId) -> Result<()> {
        self.views.retain(|(of, _)| *of != view);
        self.slaves.retain(|(of, _, _)| *of != view);
        self.viewer()?.remove_view(view)?;
        Ok(())
    }

    /// Removes the pages of a scene, and checks that those of the others stay.
    fn clear_scene(&mut self, number: usize) -> Result<()> {
        let mut left = self.pages_in_each()?;
        left[number] = 0;
        let scene = self.scenes[number];
        self.viewer()?.clear_pages(scene)?;
        let found = self.pages_in_each()?;
        let says = || format!("{found:?} instead of {left:?}");
        self.failures.check(found == left, "a clear removed pages of another scene", self.frame, says);
        Ok(())
    }

    /// Adds a scene. Its root is loaded without faults of the server.
    fn add_scene_without_faults(&mut self) -> Result<()> {
        self.set_faulty(false);
        let mut viewer = self.viewer.take().context("the viewer is gone")?;
        let added = self.add_scene(&mut viewer);
        self.viewer = Some(viewer);
        self.set_faulty(true);
        added?;
        Ok(())
    }

    fn remove_scene(&mut self, number: usize) -> Result<()> {
        let scene = self.scenes.remove(number);
        for (view, _) in self.views.clone() {
            if self.viewer()?.scene_of(view)? == scene {
                self.remove_view(view)?;
            }
        }
        if let Some(own) = self.pagers.iter().position(|scenes| *scenes == [scene]) {
            self.pagers.remove(own);
            if let Some(pager) = self.viewer()?.pager(scene)? {
                let stats = *pager.stats();
                self.sum_up(&stats);
            }
        }
        self.pagers.iter_mut().for_each(|scenes| scenes.retain(|of| *of != scene));
        Ok(self.viewer()?.remove_scene(scene)?)
    }

    /// Announces the path of a view from the next frame on.
    fn announce(&mut self, view: usize, path_of: usize) -> Result<()> {
        let poses = &self.plan.poses[path_of % self.plan.poses.len()];
        let rest = poses.iter().enumerate().skip(self.frame as usize).step_by(FRAMES_PER_POINT);
        let point = |(frame, pose)| ControlPoint::from_pose(time_s(frame as u32), &world_from_eye(&self.bounds, pose));
        let path = AnimationPath::new(rest.map(point).collect())?;
        let view = self.views[view].0;
        self.viewer()?.view_mut(view)?.announced = Some(path);
        Ok(())
    }
}
