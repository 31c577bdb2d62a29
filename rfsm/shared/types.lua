---@meta
-- Types of the tables that a program writes and gets, for the editor. No program loads
-- this file. Licence: BSD, 3 clauses.

--- A state as the user writes it.
--
-- Every key not named here is the user's data. Only a leaf can have a doo, which runs
-- as a coroutine. If the doo yields a true value, it is idle.
--
---@class rfsm.State
---@field entry? rfsm.StateCallback
---@field exit? rfsm.StateCallback
---@field doo? false|fun(fsm: rfsm.Machine, state: rfsm.State, what: "doo"): boolean?
---@field final? boolean a leaf that ends its composite or region
---@field history? "shallow"|"deep" needs `rfsm.history`; of a composite
---@field defer? any[] events that wait while no transition takes them (`rfsm.defer`)
---@field timed? boolean `rfsm_timeevent.time_in` knows the state
---@field prepare? fun(fsm: rfsm.Machine) called when the state is likely next
---@field keep? string[] names of the fields that snapshots and fleets save
---@field save? fun(fsm: rfsm.Machine, state: rfsm.State): any data for snapshots
---@field load? fun(fsm: rfsm.Machine, state: rfsm.State, data: any) takes these data
---@field checks? table<string, string> code of a finding -> reason why it is silenced
---@field getevents? false|fun(): any[]? root only, as all fields below
---@field dbg? boolean|fun(id: string, ...)
---@field info? boolean|fun(...)
---@field warn? boolean|fun(...)
---@field err? boolean|fun(...)
---@field idle_hook? false|fun(fsm: rfsm.Machine) called instead of returning when idle
---@field pre_step_hook? false|fun(fsm: rfsm.Machine, events: any[])
---@field post_step_hook? false|fun(fsm: rfsm.Machine, events: any[])
---@field read? "all"|"one" "one": an iteration takes only the first pending event
---@field strict? boolean warn of what is probably a mistake
---@field properties? table<any, rfsm_checks.Property> what must hold
---@field gettime? false|fun(): number, number the machine's clock: seconds, nanoseconds
---@field [string|integer] any

--- A state as a constructor returns it: a model, of which `rfsm.init` makes a machine.
---@class rfsm.Model : rfsm.State

--- An edge from one state or connector to another, as the user writes it.
---@class rfsm.Edge
---@field src string|rfsm.State|rfsm.Connector source; after init always a node
---@field tgt string|rfsm.State|rfsm.Connector target; after init always a node
---@field events? false|any[]|string each one triggers it; none: any event does
---@field always? boolean true: it needs no event, and has none
---@field guard? rfsm.Guard
---@field effect? rfsm.Effect
---@field pn? number priority among the transitions of a node, larger first (0)
---@field likely? fun(fsm: rfsm.Machine): boolean? its target is prepared if true
---@field checks? table<string, string> code of a finding -> reason why it is silenced
---@field [string] any

--- A transition of a machine.
---@class rfsm.Transition : rfsm.Edge
---@field _fsm rfsm.Machine

--- A connector joins transitions into a path. It is never active.
---@class rfsm.Connector
---@field [string] any

---@alias rfsm.Node rfsm.State|rfsm.Connector

--- A machine, which `rfsm.init` makes from a model. It is also its root state.
---@class rfsm.Machine : rfsm.State
---@field _act_leaf rfsm.State|false the innermost active state
---@field _intq any[] events that wait for the next iteration
---@field _curq any[] events of the running iteration
---@field emit fun(event: string, data?: any) for callbacks; see `rfsm.set_emit`

---@class rfsm.StateConstructor
---@field new fun(self: any, t: rfsm.State): rfsm.Model
---@overload fun(t: rfsm.State): rfsm.Model

---@class rfsm.TransitionConstructor
---@field new fun(self: any, t: rfsm.Edge): rfsm.Transition
---@overload fun(t: rfsm.Edge): rfsm.Transition

---@class rfsm.ConnectorConstructor
---@field new fun(self: any, t: table): rfsm.Connector
---@overload fun(t: table): rfsm.Connector

--- Callbacks. Their last argument `event` is the event that counts: the first current
--- event that enables the segment of the path; for a segment without events that of the
--- path's first segment, or the first current event. It is nil if no event leads here.
---@alias rfsm.StateCallback false|fun(fsm, state: rfsm.State, what: string, event: any)
---@alias rfsm.Guard false|fun(tr, events: any[], event: any): boolean? false forbids
---@alias rfsm.Effect false|fun(fsm, tr, what: "effect", events: any[], event: any)

--- An occasion on which a watch hook is called, see `rfsm.watch_hook_add`.
---@alias rfsm.Watched "sent"|"failed"|"failed_inside"|"resumed"|"ended"|"merged"
---|"discarded"

--- What became of an event: the first of these words that is true.
---@alias rfsm.Fate "taken"|"kept"|"forwarded"|"discarded"

--- Who has used an event.
---@class rfsm.Use
---@field fate rfsm.Fate
---@field transition? rfsm.Transition that has taken it: the first one of the path
---@field state? rfsm.State for which an extension keeps it, or that has the region
---@field word? string what the extension does: "defers"
---@field region? rfsm.Machine that has taken or kept it

--- An event that an extension would keep, see `rfsm.foretell`.
---@class rfsm.Kept
---@field event any
---@field state rfsm.State
---@field word string what the extension does: "defers"

--- Hooks. For each `X_hook_add` there is an `X_hook_rm` with the same arguments. It
--- returns true if there was such a hook. `place` is "before" or "after" (default) the
--- other hooks. An error of a source or step hook is raised at once, an error of any
--- other hook when the iteration is over.
---@alias rfsm.StepHook fun(fsm: rfsm.Machine, events: any[])
---@alias rfsm.StateHook fun(fsm: rfsm.Machine, state: rfsm.State, event: any)
---@alias rfsm.FateHook fun(fsm: rfsm.Machine, event, fate: rfsm.Fate, who: rfsm.Use)
---@alias rfsm.ReactionHook fun(fsm, state, events?: any[]): any[]?, string?, any[]?
---@alias rfsm.HookPlace "before"|"after"|"front"

---@class rfsm
---@field source_hook_add fun(fsm: rfsm.Machine, hook: rfsm.StepHook) the hook appends
-- events to the list of current events, before all other hooks and before one is taken
---@field pre_step_hook_add fun(fsm: rfsm.Machine, hook: rfsm.StepHook, place?: string)
-- in each iteration before a transition is chosen; the hook may change the events
---@field post_step_hook_add fun(fsm: rfsm.Machine, hook: rfsm.StepHook, place?: string)
-- at the end of each iteration
---@field path_hook_add fun(fsm: rfsm.Machine, hook: fun(fsm, path: any[], event: any))
-- before a path, a list of transitions, is taken; for observers
---@field entry_hook_add fun(fsm: rfsm.Machine, state: rfsm.State, hook: rfsm.StateHook)
-- each time a state is entered, before its entry
---@field exit_hook_add fun(fsm: rfsm.Machine, state: rfsm.State, hook: rfsm.StateHook)
-- each time a state is left, after its exit
---@field guard_hook_add fun(fsm: rfsm.Machine, tr: rfsm.Transition, hook: rfsm.Guard)
-- asked before the guard; the transition is not enabled if the hook returns false
---@field watch_hook_add fun(fsm: rfsm.Machine, what: rfsm.Watched, hook: function)
-- hook(fsm, ...): sent: event, ... | failed: element, name, error | resumed: leaf |
-- ended: leaf | merged: element | discarded: an event that nobody has used
---@field fate_hook_add fun(fsm: rfsm.Machine, hook: rfsm.FateHook) what became of an
-- event, once for each, at the end of an iteration
---@field reset_hook_add fun(fsm: rfsm.Machine, hook: fun(fsm), place?: string)
-- when the machine is reset, to reset the data of an extension
---@field reaction_hook_add fun(fsm: rfsm.Machine, hook: rfsm.ReactionHook)
-- lists the events to which an extension reacts in a state; a function is a predicate.
-- A word behind them has pictures show them in the state: "e_job / defer".
-- With `events`: those of them that it would keep now, the word for that ("defers"),
-- and the events that it would add to them
---@field waiting_hook_add fun(fsm: rfsm.Machine, hook: fun(fsm): any[]?)
-- lists the events that an extension keeps for later

--- The field `_regions` of a state in which an extension runs machines.
---@class rfsm.Regions
---@field [integer] rfsm.Machine the machines, in the order in which they are stepped
---@field names any[] the names of these machines, in the same order
---@field entry? function the user's entry, if the extension has replaced it
---@field exit? function the user's exit, if the extension has replaced it

--- What one call of `init` or `fsm_merge` finds while it builds elements.
---@class rfsm.Build
---@field fsm rfsm.Machine the machine, or the one that `fsm_merge` extends
---@field problems { file?: string, line: string }[]
---@field warnings { file?: string, line: string }[]
---@field created { line: string }[] a message for each `initial` that was created
---@field mounts table<table, table[]> node of the model -> the nodes made of it
---@field copies table<table, table> plain table in the user's data -> its copy

--- A transition with the target that it has now, a part of a path.
---@class rfsm.Segment
---@field tr rfsm.Transition
---@field tgt rfsm.State|rfsm.Connector a leaf or a connector
---@field connector? rfsm.Connector the target, if it is a connector
---@field is_internal? true nothing is left or entered
---@field lca rfsm.State the innermost state that contains both ends and stays active

--- A kind of hooks: rfsm.<kind>_hook_add and _rm.
---@class rfsm.HookKind
---@field list string the field of the machine that has the hooks
---@field is_subject? fun(fsm, subject): boolean hooks are for parts of the machine
---@field expected? string text of a message, if `is_subject` returns false
---@field own? string the field in which a program may set one hook of this kind
---@field is_step? boolean called in each iteration
---@field is_path? boolean the lists of actions contain these hooks

--- Predicates: any value may be asked about.
---@class rfsm
---@field is_meta fun(key: any): boolean
---@field is_state fun(value: any): boolean
---@field is_trans fun(value: any): boolean
---@field is_conn fun(value: any): boolean
---@field is_fsmobj fun(value: any): boolean
---@field is_node fun(value: any): boolean
---@field is_composite fun(value: any): boolean
---@field is_leaf fun(value: any): boolean
---@field is_root fun(value: any): boolean
---@field is_initialized_root fun(value: any): boolean
---@field is_nr_node fun(value: any): boolean
---@field is_callable fun(value: any): boolean
