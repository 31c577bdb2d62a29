--- Leases of machines that are due, in both servers.
--
-- A worker leases a machine, in a call or transaction of its own, before it runs the
-- machine. If the machine does not come to an end, the call is killed and leaves
-- nothing, but the lease stays: until it is over the worker runs other machines.
--
-- @module rfsm.server.lease
-- @license BSD-3-Clause

return {
  --- Seconds of a lease.
  SECONDS = 10,
  --- After so many leases that came to no end the machine is held.
  MOST = 3,
  --- The reason for the log of the machine.
  REASON = "3 calls that ran what is due have not ended: held until it is released",
}
