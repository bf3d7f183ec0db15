//! Starts and stops the threads of a model. Main thread, between frames, with no frame in flight.

use std::sync::Arc;

use super::cores;
use super::cull_side::CullSide;
use super::device::DeviceHandle;
use super::draw_side::DrawSide;
use super::model::ThreadingModel;
use super::operations::{BarrierOperation, Cull, Pin, StartOfCull, Step};
use super::stage::{CameraSide, Rendering, Running};
use crate::sync::{Barrier, BlockCount, Operation, OperationThread};
use crate::viewer::ViewerError;

fn overlaps(model: ThreadingModel) -> bool {
    use ThreadingModel::{CullThreadPerCameraDrawThreadPerContext, DrawThreadPerContext};
    matches!(model, DrawThreadPerContext | CullThreadPerCameraDrawThreadPerContext)
}

impl Rendering {
    /// Returns the model that runs, or would run.
    pub(in crate::viewer) fn model(&self) -> ThreadingModel {
        match &self.running {
            Some(running) => running.model,
            // `set_model` has checked the environment variable.
            None => self.resolved(self.model).unwrap_or(ThreadingModel::SingleThreaded),
        }
    }

    /// Sets the model from the next frame on; no frame may be in flight.
    pub(in crate::viewer) fn set_model(&mut self, model: ThreadingModel) -> Result<(), ViewerError> {
        self.resolved(model)?;
        self.stop_threads();
        self.model = model;
        Ok(())
    }

    /// Fails if the model that was asked for cannot run with the devices there are.
    pub(in crate::viewer) fn check_model(&self) -> Result<(), ViewerError> {
        self.resolved(self.model).map(drop)
    }

    /// Resolves a model to one that can run. The application's own device is used by the main thread alone.
    fn resolved(&self, model: ThreadingModel) -> Result<ThreadingModel, ViewerError> {
        let has_host_device = self.devices.iter().any(DeviceHandle::is_host_device);
        match model {
            ThreadingModel::AutomaticSelection if has_host_device => Ok(ThreadingModel::SingleThreaded),
            _ if has_host_device && model != ThreadingModel::SingleThreaded => Err(ViewerError::Setting(format!(
                "{model} draws on other threads, but the application's own device must be used by one thread; choose \
                 SingleThreaded"
            ))),
            _ => model.resolved(self.context_ids().count(), self.cameras.len()).map_err(ViewerError::Setting),
        }
    }

    /// Returns true while the threads of the model run, if it has any.
    pub(in crate::viewer) fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Returns the core for the pagers' threads: in the single-threaded model, where the main thread has the first core to
    /// itself.
    pub(in crate::viewer) fn pager_core(&self) -> Option<usize> {
        let is_single = self.model() == ThreadingModel::SingleThreaded;
        let cores = (self.pins_threads && is_single).then(cores::single_threaded).flatten();
        cores.map(|[_, pagers]| pagers.id)
    }

    /// Returns true when update may run in parallel with draw.
    pub(in crate::viewer) fn overlaps(&self) -> bool {
        overlaps(self.model())
    }

    /// Starts the model's threads unless they run.
    pub(in crate::viewer) fn start_threads(&mut self) -> Result<(), ViewerError> {
        if self.running.is_some() {
            return Ok(());
        }
        let (contexts, cameras) = (self.devices.len(), self.cameras.len());
        let model = self.resolved(self.model)?;
        let barrier = |threads| Some(Arc::new(Barrier::new(threads)));
        let (start, end) = match model {
            ThreadingModel::CullDrawThreadPerContext => (barrier(contexts + 1), barrier(contexts + 1)),
            ThreadingModel::CullThreadPerCameraDrawThreadPerContext => (barrier(cameras + 1), None),
            _ => (None, None),
        };
        let end_of_dynamic = overlaps(model).then(|| Arc::new(BlockCount::new(cameras)));
        for context in &mut self.devices {
            let side = context.here().ok_or(ViewerError::DrawThreadStopped)?;
            side.end_of_dynamic = end_of_dynamic.clone();
        }
        for camera in &mut self.cameras {
            let CameraSide::Here(side) = &mut camera.side else { return Err(ViewerError::DrawThreadStopped) };
            side.end_of_dynamic = end_of_dynamic.clone();
        }
        let running = Running { model, start: start.clone(), end: end.clone(), end_of_dynamic: end_of_dynamic.clone() };
        self.running = Some(running);
        let started = match model {
            ThreadingModel::SingleThreaded | ThreadingModel::AutomaticSelection => {
                if let Some([main, _]) = self.pins_threads.then(cores::single_threaded).flatten() {
                    cores::pin(main);
                }
                Ok(())
            }
            ThreadingModel::CullDrawThreadPerContext => {
                self.give_cameras_to_contexts();
                self.start_contexts(start.as_ref(), end.as_ref(), None)
            }
            ThreadingModel::DrawThreadPerContext => self.start_contexts(None, None, end_of_dynamic.as_ref()),
            ThreadingModel::CullThreadPerCameraDrawThreadPerContext => {
                let contexts = self.start_contexts(None, None, end_of_dynamic.as_ref());
                contexts.and_then(|()| self.start_cameras(start.as_ref(), end_of_dynamic.as_ref()))
            }
        };
        if started.is_err() {
            self.stop_threads();
        }
        started
    }

    /// Moves the cameras to the threads of their contexts, which cull them.
    fn give_cameras_to_contexts(&mut self) {
        for camera in &mut self.cameras {
            let context = self.devices.iter_mut().find(|c| c.size_px(camera.context).is_some());
            let Some(side) = context.and_then(|c| c.here()) else { continue };
            match std::mem::replace(&mut camera.side, CameraSide::AtContext) {
                CameraSide::Here(cull) => side.culls.push(*cull),
                other => camera.side = other,
            }
        }
    }

    fn start_contexts(
        &mut self,
        start: Option<&Arc<Barrier>>,
        end: Option<&Arc<Barrier>>,
        end_of_dynamic: Option<&Arc<BlockCount>>,
    ) -> Result<(), ViewerError> {
        let swap_ready = Arc::new(Barrier::new(self.devices.len()));
        let mut cores = self.pins_threads.then(cores::for_threads).into_iter().flatten();
        for context in &mut self.devices {
            let step = |name, run: fn(&mut DrawSide)| -> Arc<dyn Operation<DrawSide>> {
                Arc::new(Step { name, run, end_of_dynamic: end_of_dynamic.cloned() })
            };
            let meet = |name, barrier: &Arc<Barrier>| -> Arc<dyn Operation<DrawSide>> {
                Arc::new(BarrierOperation { name, barrier: barrier.clone() })
            };
            let mut operations: Vec<Arc<dyn Operation<DrawSide>>> = Vec::new();
            operations.extend(cores.next().map(|core| -> Arc<dyn Operation<DrawSide>> { Arc::new(Pin(core)) }));
            operations.push(step("await frame", DrawSide::await_frame));
            operations.extend(start.map(|barrier| meet("start barrier", barrier)));
            operations.push(step("render", DrawSide::render));
            operations.push(meet("swap ready", &swap_ready));
            operations.push(step("swap", DrawSide::swap));
            operations.extend(end.map(|barrier| meet("end barrier", barrier)));
            context.start(operations)?;
        }
        Ok(())
    }

    fn start_cameras(
        &mut self,
        start: Option<&Arc<Barrier>>,
        end_of_dynamic: Option<&Arc<BlockCount>>,
    ) -> Result<(), ViewerError> {
        // The first cores are those of the contexts.
        let mut cores = self.pins_threads.then(cores::for_threads).into_iter().flatten().skip(self.devices.len());
        for camera in &mut self.cameras {
            camera.side = match std::mem::replace(&mut camera.side, CameraSide::Lost) {
                CameraSide::Here(side) => {
                    let mut operations: Vec<Arc<dyn Operation<CullSide>>> = Vec::new();
                    operations.extend(cores.next().map(|core| -> Arc<dyn Operation<CullSide>> { Arc::new(Pin(core)) }));
                    if let Some(barrier) = start {
                        operations.push(Arc::new(StartOfCull(barrier.clone())));
                    }
                    operations.push(Arc::new(Cull(end_of_dynamic.cloned())));
                    let name = format!("cull {}", camera.number);
                    CameraSide::Thread(OperationThread::start(&name, *side, operations).map_err(ViewerError::Thread)?)
                }
                other => other,
            };
        }
        Ok(())
    }

    /// Ends all threads and takes back what they owned. Waits for their current operations; frames in flight are dropped.
    pub(in crate::viewer) fn stop_threads(&mut self) {
        if self.running.take().is_none() {
            return;
        }
        let camera_threads = || {
            self.cameras.iter().filter_map(|camera| match &camera.side {
                CameraSide::Thread(thread) => Some(thread),
                _ => None,
            })
        };
        // All threads get the signal before any is woken: a barrier that is released for one is released for all.
        camera_threads().for_each(OperationThread::end);
        self.devices.iter().for_each(DeviceHandle::end);
        camera_threads().for_each(OperationThread::cancel);
        self.devices.iter().for_each(DeviceHandle::cancel);
        // Culling threads are joined first, because a context's thread may wait for their stages.
        for camera in &mut self.cameras {
            camera.side = match std::mem::replace(&mut camera.side, CameraSide::Lost) {
                CameraSide::Thread(thread) => match thread.join() {
                    Ok(side) => CameraSide::Here(Box::new(side)),
                    Err(panicked) => {
                        log::error!("{panicked}");
                        CameraSide::Lost
                    }
                },
                other => other,
            };
        }
        for context in &mut self.devices {
            context.stop();
            let Some(side) = context.here() else { continue };
            side.end_of_dynamic = None;
            for cull in side.culls.drain(..) {
                if let Some(camera) = self.cameras.iter_mut().find(|c| c.number == cull.camera) {
                    camera.side = CameraSide::Here(Box::new(cull));
                }
            }
        }
        for camera in &mut self.cameras {
            match &mut camera.side {
                CameraSide::Here(side) => side.end_of_dynamic = None,
                CameraSide::AtContext => camera.side = CameraSide::Lost,
                CameraSide::Thread(_) | CameraSide::Lost => {}
            }
        }
    }
}

impl Drop for Rendering {
    /// Ends the threads, so that contexts are dropped on the main thread, where their windows are.
    fn drop(&mut self) {
        self.stop_threads();
    }
}
