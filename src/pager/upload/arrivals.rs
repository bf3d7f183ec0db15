//! [`Arrivals`]: pages that were loaded and wait for their upload or their merge. Update thread.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use super::context::CompileContext;
use crate::fetch::ContentMemory;
use crate::gpu::{CompileBudget, CompileOperation, Compiled};
use crate::pager::loading::ticket::Ticket;
use crate::pager::loading::waiting_jobs::Urgency;
use crate::pager::residency::budget::{ArrivedTotal, Budget, MemoryUse};
use crate::scene::{DrawKind, DrawSlot, Drawable, NodeId, Page};

/// The drawables of a page that are not uploaded yet.
struct Payload {
    drawables: Vec<Drawable>,
    kinds: Arc<[DrawKind]>,
    bytes: u64,
}

/// A page that waits for its upload or its merge.
pub(in crate::pager) struct Arrived {
    ticket: Ticket,
    urgency: Urgency,
    page: Box<Page>,
    /// By context id.
    gpu_bytes: Vec<(u32, u64)>,
    /// Contexts that have not uploaded it yet.
    contexts_left: usize,
    /// Memory in use, without shared contents.
    bytes: MemoryUse,
    /// GPU bytes that uploads which have begun may take besides.
    reserved_gpu: u64,
    /// `Some` until its uploads begin.
    payload: Option<Payload>,
    /// Its bytes in the budget of what is on its way, and its turn if it is large.
    _memory: Option<ContentMemory>,
}

impl Arrived {
    /// Returns the page.
    pub fn page(&self) -> &Page {
        &self.page
    }

    /// Returns the page and its GPU bytes by context id.
    pub fn into_page(self) -> (Box<Page>, Vec<(u32, u64)>) {
        (self.page, self.gpu_bytes)
    }

    /// Returns the memory in use, without shared contents. The GPU bytes are complete once it is uploaded.
    pub fn bytes(&self) -> MemoryUse {
        self.bytes
    }

    /// Returns true if all contexts have uploaded it.
    pub fn is_uploaded(&self) -> bool {
        self.contexts_left == 0
    }

    fn is_uploading(&self) -> bool {
        self.contexts_left > 0 && self.payload.is_none()
    }

    fn place(&self, slot: NodeId) -> Place {
        Reverse((self.urgency, Reverse(slot)))
    }

    /// Returns the ticket by which contexts know the upload, if it has begun and not ended.
    pub fn upload_ticket(&self) -> Option<u64> {
        self.is_uploading().then(|| self.ticket.number())
    }
}

/// The effect of a finished compile operation.
pub(in crate::pager) enum Uploaded {
    /// The page is gone; its slots go back to the context.
    Late(Vec<DrawSlot>),
    /// Other contexts have not finished.
    Partly(NodeId),
    /// All contexts have uploaded the page of this slot.
    Completely(NodeId),
}

/// The place of a page in an order with the most urgent first.
type Place = Reverse<(Urgency, Reverse<NodeId>)>;

fn slot_of(Reverse((_, Reverse(slot))): &Place) -> NodeId {
    *slot
}

/// The pages that have arrived. Update thread.
///
/// The totals and the orders are those of all pages: a page is subtracted, changed and added again.
#[derive(Default)]
pub(in crate::pager) struct Arrivals {
    pages: HashMap<NodeId, Arrived>,
    /// Slots of pages that are not uploaded, by ticket number.
    by_ticket: HashMap<u64, NodeId>,
    total: ArrivedTotal,
    /// All pages.
    order: BTreeSet<Place>,
    /// Pages whose upload has not begun.
    waiting: BTreeSet<Place>,
    /// Pages that wait for their merge.
    ready: BTreeSet<Place>,
    /// The number of prefetches.
    prefetches: usize,
    /// Compile operations that contexts, by their ids, have finished and that update has not taken, the oldest first.
    finished: VecDeque<(u32, Compiled)>,
}

impl Arrivals {
    /// Returns the sums over all pages.
    pub fn total(&self) -> &ArrivedTotal {
        &self.total
    }

    /// Returns true if a page waits for contexts, or for its upload to begin.
    pub fn has_uploads(&self) -> bool {
        !self.by_ticket.is_empty()
    }

    /// Returns true if a compile operation belongs to a page whose upload has begun and not ended.
    pub fn is_uploading(&self, ticket: u64) -> bool {
        let slot = self.by_ticket.get(&ticket);
        slot.and_then(|slot| self.pages.get(slot)).is_some_and(Arrived::is_uploading)
    }

    /// Returns the number of compile operations that have begun and not ended, over all contexts.
    pub fn operations_left(&self) -> usize {
        let uploading = self.pages.values().filter(|arrived| arrived.is_uploading());
        uploading.map(|arrived| arrived.contexts_left).sum()
    }

    /// Adds compile operations that a context has finished.
    pub fn add_finished(&mut self, context: u32, compiled: Vec<Compiled>) {
        self.finished.extend(compiled.into_iter().map(|compiled| (context, compiled)));
    }

    /// Takes the oldest compile operation that was finished and not taken, with the id of its context.
    pub fn next_finished(&mut self) -> Option<(u32, Compiled)> {
        self.finished.pop_front()
    }

    /// Returns true if a compile operation was finished and not taken.
    pub fn has_finished(&self) -> bool {
        !self.finished.is_empty()
    }

    /// Takes the finished compile operations whose pages are gone: context ids and slots to release.
    pub fn take_late(&mut self) -> Vec<(u32, Vec<DrawSlot>)> {
        let (kept, late) = std::mem::take(&mut self.finished)
            .into_iter()
            .partition(|(_, compiled)| self.by_ticket.contains_key(&compiled.ticket));
        self.finished = kept;
        let late: VecDeque<(u32, Compiled)> = late;
        late.into_iter().map(|(context, compiled)| (context, compiled.slots)).collect()
    }

    /// Forgets what a context has finished that has closed.
    pub fn forget_context(&mut self, context: u32) {
        self.finished.retain(|(id, _)| *id != context);
    }

    /// Returns true if a page waits for its merge.
    pub fn has_ready(&self) -> bool {
        !self.ready.is_empty()
    }

    /// Returns the page of a slot.
    pub fn get(&self, slot: NodeId) -> Option<&Arrived> {
        self.pages.get(&slot)
    }

    /// Returns the number of prefetches.
    pub fn prefetches(&self) -> usize {
        self.prefetches
    }

    /// Adds a page to be uploaded to this many contexts; one without drawables is ready for its merge at once.
    pub fn insert(
        &mut self,
        (slot, urgency): (NodeId, Urgency),
        ticket: Ticket,
        (mut page, memory): (Page, Option<ContentMemory>),
        kinds: Arc<[DrawKind]>,
        contexts: usize,
    ) {
        let all_bytes = page.size_bytes();
        let drawables = page.take_drawables();
        let contexts_left = if drawables.is_empty() { 0 } else { contexts };
        let bytes = all_bytes.saturating_sub(page.size_bytes());
        let arrived = Arrived {
            ticket,
            urgency,
            gpu_bytes: Vec::new(),
            contexts_left,
            bytes: MemoryUse { cpu: page.own_bytes(), gpu: 0 },
            reserved_gpu: 0,
            payload: (contexts_left > 0).then_some(Payload { drawables, kinds, bytes }),
            page: Box::new(page),
            _memory: memory,
        };
        if contexts_left > 0 {
            self.by_ticket.insert(ticket.number(), slot);
        }
        self.add(slot, &arrived);
        self.pages.insert(slot, arrived);
    }

    /// Changes the urgency of a page.
    pub fn set_urgency(&mut self, slot: NodeId, urgency: Urgency) {
        let Some(arrived) = self.pages.get_mut(&slot) else { return };
        let before = arrived.place(slot);
        self.prefetches -= usize::from(arrived.urgency.is_prefetch());
        self.prefetches += usize::from(urgency.is_prefetch());
        arrived.urgency = urgency;
        let after = arrived.place(slot);
        for order in [&mut self.order, &mut self.waiting, &mut self.ready] {
            if order.remove(&before) {
                order.insert(after);
            }
        }
    }

    /// Removes the page of a slot; an upload that has begun is cancelled by the caller, with [`Arrived::upload_ticket`].
    pub fn remove(&mut self, slot: NodeId) -> Option<Arrived> {
        let arrived = self.pages.remove(&slot)?;
        self.subtract(slot, &arrived);
        self.by_ticket.remove(&arrived.ticket.number());
        Some(arrived)
    }

    fn add(&mut self, slot: NodeId, arrived: &Arrived) {
        self.total.pages += 1;
        self.total.uploading += u64::from(arrived.is_uploading());
        self.total.bytes = self.total.bytes + arrived.bytes;
        self.total.reserved_gpu += arrived.reserved_gpu;
        self.prefetches += usize::from(arrived.urgency.is_prefetch());
        let place = arrived.place(slot);
        self.order.insert(place);
        if arrived.payload.is_some() {
            self.waiting.insert(place);
        }
        if arrived.is_uploaded() {
            self.ready.insert(place);
        }
    }

    fn subtract(&mut self, slot: NodeId, arrived: &Arrived) {
        self.total.pages -= 1;
        self.total.uploading -= u64::from(arrived.is_uploading());
        self.total.bytes.cpu -= arrived.bytes.cpu;
        self.total.bytes.gpu -= arrived.bytes.gpu;
        self.total.reserved_gpu -= arrived.reserved_gpu;
        self.prefetches -= usize::from(arrived.urgency.is_prefetch());
        let place = arrived.place(slot);
        self.order.remove(&place);
        self.waiting.remove(&place);
        self.ready.remove(&place);
    }

    /// Changes a page and keeps the totals.
    fn change<R>(&mut self, slot: NodeId, change: impl FnOnce(&mut Arrived) -> R) -> Option<R> {
        let mut arrived = self.pages.remove(&slot)?;
        self.subtract(slot, &arrived);
        let result = change(&mut arrived);
        self.add(slot, &arrived);
        self.pages.insert(slot, arrived);
        Some(result)
    }

    /// Returns the most urgent page whose upload has not begun: its slot, and whether it is a prefetch.
    pub fn next_upload(&self) -> Option<(NodeId, bool)> {
        self.waiting.first().map(|place| (slot_of(place), place.0.0.is_prefetch()))
    }

    /// Returns the bytes to upload of a page, for all contexts together.
    pub fn upload_bytes(&self, slot: NodeId) -> u64 {
        let bytes = |arrived: &Arrived| {
            let payload = arrived.payload.as_ref().map_or(0, |payload| payload.bytes);
            payload.saturating_mul(arrived.contexts_left as u64)
        };
        self.pages.get(&slot).map_or(0, bytes)
    }

    /// Queues the drawables of a page in all contexts and reserves GPU memory for them. Without `pre_compile` they are
    /// uploaded at once, however long that takes.
    pub fn begin_upload(
        &mut self,
        slot: NodeId,
        reserved_gpu: u64,
        contexts: &mut [&mut dyn CompileContext],
        pre_compile: bool,
    ) {
        let begun = self.change(slot, |arrived| {
            arrived.reserved_gpu = reserved_gpu;
            (arrived.ticket.number(), arrived.payload.take())
        });
        let Some((ticket, Some(Payload { drawables, kinds, .. }))) = begun else { return };
        let last = contexts.len().saturating_sub(1);
        let mut drawables = Some(drawables);
        for (i, context) in contexts.iter_mut().enumerate() {
            let copy = if i == last { drawables.take() } else { drawables.clone() };
            context.prewarm(&kinds);
            context.compile(CompileOperation { ticket, drawables: copy.unwrap_or_default() });
            if !pre_compile {
                context.run_compiles(&CompileBudget { time: Duration::MAX, bytes: u64::MAX });
            }
        }
    }

    /// Notes that a context has finished a compile operation.
    pub fn uploaded(&mut self, context: u32, compiled: Compiled) -> Uploaded {
        let Compiled { ticket, slots, bytes, .. } = compiled;
        let Some(slot) = self.by_ticket.get(&ticket).copied() else { return Uploaded::Late(slots) };
        let left = self.change(slot, |arrived| {
            arrived.gpu_bytes.push((context, bytes));
            arrived.page.set_draw_slots(context, slots);
            arrived.contexts_left = arrived.contexts_left.saturating_sub(1);
            arrived.bytes = MemoryUse { cpu: arrived.page.own_bytes(), gpu: arrived.bytes.gpu + bytes };
            let is_last = arrived.contexts_left == 0;
            arrived.reserved_gpu = if is_last { 0 } else { arrived.reserved_gpu.saturating_sub(bytes) };
            arrived.contexts_left
        });
        if left != Some(0) {
            return Uploaded::Partly(slot);
        }
        self.by_ticket.remove(&ticket);
        Uploaded::Completely(slot)
    }

    /// Returns the slots of the pages that wait for their merge, the most urgent first.
    pub fn ready_to_merge(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.ready.iter().map(slot_of)
    }

    /// Finds the first page, the most urgent first, that exceeds the budgets beside those before it and `merged_pages` that
    /// take `merged`. Returns the last page if none does.
    pub fn first_without_room(&self, budget: &Budget, merged: MemoryUse, merged_pages: u64) -> Option<NodeId> {
        let (mut bytes, mut pages) = (merged, merged_pages);
        for slot in self.order.iter().map(slot_of) {
            bytes = bytes + self.pages.get(&slot).map_or(MemoryUse::default(), Arrived::bytes);
            pages += 1;
            if budget.is_exceeded(bytes, pages) {
                return Some(slot);
            }
        }
        self.order.last().map(slot_of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pager::loading::page_job::tests::job;
    use crate::scene::Node;

    #[test]
    fn totals_follow_the_pages() {
        let mut arrivals = Arrivals::default();
        let (first, second) = (job(1, "/a.glb"), job(2, "/b.glb"));
        for job in [&first, &second] {
            let page = Page::from_node(Node::group(Vec::new())).unwrap();
            arrivals.insert((job.slot, Urgency::new(1.0, false)), job.ticket, (page, None), Arc::new([]), 2);
        }
        assert_eq!(arrivals.total().pages, 2);
        assert!(arrivals.has_ready() && !arrivals.has_uploads(), "without drawables there is nothing to upload");
        assert_eq!(arrivals.ready_to_merge().count(), 2);
        let (shared, errors) = (Vec::new(), Vec::new());
        let late = Compiled { ticket: 9, slots: Vec::new(), bytes: 7, shared, errors, unused_bytes: 0 };
        assert!(matches!(arrivals.uploaded(0, late), Uploaded::Late(_)));
        for job in [&first, &second] {
            assert!(arrivals.remove(job.slot).is_some_and(|arrived| arrived.upload_ticket().is_none()));
        }
        assert_eq!(*arrivals.total(), ArrivedTotal::default());
        assert!(!arrivals.has_ready());
    }
}
