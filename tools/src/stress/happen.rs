//! What happens before a frame, by the plan.

use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use glam::{DMat4, DVec3};
use terrane::viewer::{AnimationPath, ControlPoint, Slave};

use super::flight::{Flight, time_s, world_from_eye};
use super::plan::{Event, MOST_CONTEXTS, MOST_SCENES, MOST_VIEWS};

/// Frames from one point of an announced way to the next.
const FRAMES_OF_POINT: usize = 4;

impl Flight<'_> {
    pub(super) fn happen(&mut self, event: Event) -> Result<()> {
        let (scenes, scene_count) = (self.scenes.clone(), self.scenes.len());
        let at = |list: usize, any: usize| any % list.max(1);
        match event {
            Event::Model(model) => self.viewer()?.set_threading_model(model)?,
            Event::StopThreads => self.viewer()?.stop_threading()?,
            Event::Resize { context, size_px } => {
                let context = self.contexts[at(self.contexts.len(), context)];
                self.viewer()?.resize_context(context, size_px)?;
            }
            Event::OpenContext if self.contexts.len() < MOST_CONTEXTS => {
                let context = self.context()?;
                let opened = self.viewer()?.open_context(context)?;
                self.contexts.push(opened);
            }
            // The first one stays, for the pictures.
            Event::CloseContext(any) if self.contexts.len() > 1 => {
                let place = 1 + at(self.contexts.len() - 1, any);
                let closed = self.contexts.remove(place);
                ensure!(self.viewer()?.close_context(closed)?, "an open context is not there");
                self.slaves.retain(|(_, _, context)| *context != closed);
                for (view, context) in self.views.clone() {
                    if context == closed {
                        self.viewer()?.remove_view(view)?;
                        self.views.retain(|(of, _)| *of != view);
                        self.slaves.retain(|(of, _, _)| *of != view);
                    }
                }
            }
            Event::AddView { context, scene, part } if self.views.len() < MOST_VIEWS => {
                self.add_view(scene, context, part)?;
            }
            Event::RemoveView(any) if self.views.len() > 1 => {
                let (view, _) = self.views.remove(1 + at(self.views.len() - 1, any));
                self.slaves.retain(|(of, _, _)| *of != view);
                self.viewer()?.remove_view(view)?;
            }
            Event::AddSlave { view, context, shift } if self.slaves.len() < MOST_VIEWS => {
                let view = self.views[at(self.views.len(), view)].0;
                let context = self.contexts[at(self.contexts.len(), context)];
                let offset = DMat4::from_translation(DVec3::new(shift, 0.0, 0.0));
                let slave = Slave { projection_offset: offset, ..Slave::new(context) };
                let id = self.viewer()?.add_slave(view, slave)?;
                self.slaves.push((view, id, context));
            }
            Event::RemoveSlave(any) if !self.slaves.is_empty() => {
                let (view, slave, _) = self.slaves.remove(at(self.slaves.len(), any));
                ensure!(self.viewer()?.remove_slave(view, slave)?, "a slave is not there");
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
            Event::Clear(scene) => {
                let place = at(scene_count, scene);
                let mut left = self.pages_in_each()?;
                left[place] = 0;
                self.viewer()?.clear_pages(scenes[place])?;
                let there = self.pages_in_each()?;
                let says = || format!("{there:?} instead of {left:?}");
                self.failures.check(there == left, "a clear took what is another scene's", self.frame, says);
            }
            Event::Sse { view, px } => {
                let view = self.views[at(self.views.len(), view)].0;
                self.viewer()?.view_mut(view)?.camera.settings.max_sse_px = px;
            }
            Event::Announce { view, way_of } => {
                let place = at(self.views.len(), view);
                self.announce(place, way_of)?;
            }
            Event::Conceal(view) => {
                let view = self.views[at(self.views.len(), view)].0;
                self.viewer()?.view_mut(view)?.announced = None;
            }
            Event::LoadProxy(any) => {
                if let (Some(proxies), Some(viewer)) = (&mut self.proxies, &mut self.viewer) {
                    proxies.load(viewer, any)?;
                }
            }
            // The first one has the proxies, the sign, and the view of the pictures.
            Event::RemoveScene if self.scenes.len() > 1 => self.remove_scene(1)?,
            Event::AddScene if self.scenes.len() < MOST_SCENES => {
                self.set_faulty(false);
                let mut viewer = self.viewer.take().context("the viewer is gone")?;
                let added = self.add_scene(&mut viewer);
                self.viewer = Some(viewer);
                self.set_faulty(true);
                added?;
            }
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

    fn remove_scene(&mut self, place: usize) -> Result<()> {
        let scene = self.scenes.remove(place);
        for (view, _) in self.views.clone() {
            if self.viewer()?.scene_of(view)? == scene {
                self.viewer()?.remove_view(view)?;
                self.views.retain(|(of, _)| *of != view);
                self.slaves.retain(|(of, _, _)| *of != view);
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

    /// The rest of a way, from the next frame on.
    fn announce(&mut self, view: usize, way_of: usize) -> Result<()> {
        let poses = &self.plan.poses[way_of % self.plan.poses.len()];
        let rest = poses.iter().enumerate().skip(self.frame as usize).step_by(FRAMES_OF_POINT);
        let point = |(frame, pose)| ControlPoint::from_pose(time_s(frame as u32), &world_from_eye(&self.bounds, pose));
        let path = AnimationPath::new(rest.map(point).collect())?;
        let view = self.views[view].0;
        self.viewer()?.view_mut(view)?.announced = Some(path);
        Ok(())
    }
}
