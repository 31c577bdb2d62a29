---@meta
-- Types of the tables that a program writes and gets, for the editor. No program loads
-- this file. Licence: BSD, 3 clauses.

--- A state as the user writes it.
--
-- Every key not named here is the user's data. Only a leaf can have a doo, which runs
-- as a coroutine. If the doo yields a true value, it is idle.
--
---@class rfsm.State
---@field entry? false|fun(fsm: rfsm.Machine, state: rfsm.State, what: "entry")
---@field exit? false|fun(fsm: rfsm.Machine, state: rfsm.State, what: "exit")
---@field doo? false|fun(fsm: rfsm.Machine, state: rfsm.State, what: "doo"): boolean?
---@field final? boolean a leaf that is meant to be the end
---@field getevents? false|fun(): any[]? root only, as all fields below
---@field dbg? boolean|fun(id: string, ...)
---@field info? boolean|fun(...)
---@field warn? boolean|fun(...)
---@field err? boolean|fun(...)
---@field idle_hook? false|fun(fsm: rfsm.Machine) called instead of returning when idle
---@field pre_step_hook? false|fun(fsm: rfsm.Machine, events: any[])
---@field post_step_hook? false|fun(fsm: rfsm.Machine, events: any[])
---@field gettime? false|fun(): number, number the machine's clock: seconds, nanoseconds
---@field [string|integer] any

--- A state as a constructor returns it: a model, of which `rfsm.init` makes a machine.
---@class rfsm.Model : rfsm.State

--- An edge from one state or connector to another, as the user writes it.
---@class rfsm.Edge
---@field src string|rfsm.State|rfsm.Connector source; after init always a node
---@field tgt string|rfsm.State|rfsm.Connector target; after init always a node
---@field events? false|any[]|string each one triggers it; none: any event does
---@field guard? false|fun(tr: rfsm.Transition, events: any[]): boolean?
-- the transition is not enabled if the guard returns false
---@field effect? false|fun(m: rfsm.Machine, tr: rfsm.Transition, s: string, e: any[])
---@field pn? number priority among the transitions of a node, larger first (0)
---@field [string] any

--- A transition of a machine.
---@class rfsm.Transition : rfsm.Edge
---@field _fsm rfsm.Machine

--- A connector joins transitions into a path. It is never active.
---@class rfsm.Connector
---@field [string] any

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

--- An occasion on which a watch hook is called, see `rfsm.watch_hook_add`.
---@alias rfsm.Watched "sent"|"failed"|"resumed"|"ended"|"merged"
