//! [`Arrivals`]: pages that were loaded and wait for their upload or their merge.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use super::context::CompileContext;
use crate::gpu::{CompileBudget, CompileOperation, Compiled};
use crate::pager::loading::ticket::Ticket;
use crate::pager::requests::entry::Entry;
use crate::pager::requests::table::RequestTable;
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

/// The pages that have arrived. Update thread.
///
/// The totals are the sums over all pages: a page is subtracted, changed and added again.
#[derive(Default)]
pub(in crate::pager) struct Arrivals {
    pages: HashMap<NodeId, Arrived>,
    /// Slots of pages that are not uploaded, by ticket number.
    by_ticket: HashMap<u64, NodeId>,
    total: ArrivedTotal,
    /// The number of pages whose upload has not begun.
    waiting: usize,
    /// The number of pages that wait for their merge.
    ready: usize,
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

    /// Returns true if a page waits for its merge.
    pub fn has_ready(&self) -> bool {
        self.ready > 0
    }

    /// Returns the page of a slot.
    pub fn get(&self, slot: NodeId) -> Option<&Arrived> {
        self.pages.get(&slot)
    }

    /// Returns the slots of all pages, in no order.
    pub fn slots(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.pages.keys().copied()
    }

    /// Adds a page to be uploaded to this many contexts; one without drawables is ready for its merge at once.
    pub fn insert(&mut self, slot: NodeId, ticket: Ticket, mut page: Page, kinds: Arc<[DrawKind]>, contexts: usize) {
        let all_bytes = page.size_bytes();
        let drawables = page.take_drawables();
        let contexts_left = if drawables.is_empty() { 0 } else { contexts };
        let bytes = all_bytes.saturating_sub(page.size_bytes());
        let arrived = Arrived {
            ticket,
            gpu_bytes: Vec::new(),
            contexts_left,
            bytes: MemoryUse { cpu: page.own_bytes(), gpu: 0 },
            reserved_gpu: 0,
            payload: (contexts_left > 0).then_some(Payload { drawables, kinds, bytes }),
            page: Box::new(page),
        };
        if contexts_left > 0 {
            self.by_ticket.insert(ticket.number(), slot);
        }
        self.add(&arrived);
        self.pages.insert(slot, arrived);
    }

    /// Removes the page of a slot; an upload that has begun is cancelled by the caller, with [`Arrived::upload_ticket`].
    pub fn remove(&mut self, slot: NodeId) -> Option<Arrived> {
        let arrived = self.pages.remove(&slot)?;
        self.subtract(&arrived);
        self.by_ticket.remove(&arrived.ticket.number());
        Some(arrived)
    }

    fn add(&mut self, arrived: &Arrived) {
        self.total.pages += 1;
        self.total.uploading += u64::from(arrived.is_uploading());
        self.total.bytes = self.total.bytes + arrived.bytes;
        self.total.reserved_gpu += arrived.reserved_gpu;
        self.waiting += usize::from(arrived.payload.is_some());
        self.ready += usize::from(arrived.is_uploaded());
    }

    fn subtract(&mut self, arrived: &Arrived) {
        self.total.pages -= 1;
        self.total.uploading -= u64::from(arrived.is_uploading());
        self.total.bytes.cpu -= arrived.bytes.cpu;
        self.total.bytes.gpu -= arrived.bytes.gpu;
        self.total.reserved_gpu -= arrived.reserved_gpu;
        self.waiting -= usize::from(arrived.payload.is_some());
        self.ready -= usize::from(arrived.is_uploaded());
    }

    /// Changes a page and keeps the totals.
    fn change<R>(&mut self, slot: NodeId, change: impl FnOnce(&mut Arrived) -> R) -> Option<R> {
        let mut arrived = self.pages.remove(&slot)?;
        self.subtract(&arrived);
        let result = change(&mut arrived);
        self.add(&arrived);
        self.pages.insert(slot, arrived);
        Some(result)
    }

    /// Returns the slots whose upload has not begun, the most urgent first.
    pub fn waiting_for_upload(&self, table: &RequestTable) -> Vec<NodeId> {
        if self.waiting == 0 {
            return Vec::new();
        }
        self.by_urgency(table, |arrived| arrived.payload.is_some())
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

    /// Returns the slots of the pages that wait for their merge, in no order.
    pub fn ready_to_merge(&self) -> Vec<NodeId> {
        self.pages.iter().filter(|(_, arrived)| arrived.is_uploaded()).map(|(slot, _)| *slot).collect()
    }

    /// Finds the first page, the most urgent first, that exceeds the budgets beside those before it and `merged_pages` that
    /// take `merged`. Returns the last page if none does.
    pub fn first_without_room(
        &self,
        table: &RequestTable,
        budget: &Budget,
        merged: MemoryUse,
        merged_pages: u64,
    ) -> Option<NodeId> {
        let order = self.by_urgency(table, |_| true);
        let (mut bytes, mut pages) = (merged, merged_pages);
        for slot in &order {
            bytes = bytes + self.pages.get(slot).map_or(MemoryUse::default(), Arrived::bytes);
            pages += 1;
            if budget.is_exceeded(bytes, pages) {
                return Some(*slot);
            }
        }
        order.last().copied()
    }

    fn by_urgency(&self, table: &RequestTable, condition: impl Fn(&Arrived) -> bool) -> Vec<NodeId> {
        let slots = self.pages.iter().filter(|(_, arrived)| condition(arrived)).map(|(slot, _)| *slot);
        let mut entries: Vec<&Entry> = slots.filter_map(|slot| table.get(slot)).collect();
        entries.sort_by(|a, b| Entry::by_urgency(a, b));
        entries.into_iter().map(|entry| entry.job.slot).collect()
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
            arrivals.insert(job.slot, job.ticket, page, Arc::new([]), 2);
        }
        assert_eq!(arrivals.total().pages, 2);
        assert!(arrivals.has_ready() && !arrivals.has_uploads(), "without drawables there is nothing to upload");
        assert_eq!(arrivals.ready_to_merge().len(), 2);
        let late = Compiled { ticket: 9, slots: Vec::new(), bytes: 7, shared: Vec::new(), errors: Vec::new() };
        assert!(matches!(arrivals.uploaded(0, late), Uploaded::Late(_)));
        for job in [&first, &second] {
            assert!(arrivals.remove(job.slot).is_some_and(|arrived| arrived.upload_ticket().is_none()));
        }
        assert_eq!(*arrivals.total(), ArrivedTotal::default());
        assert!(!arrivals.has_ready());
    }
}
