--- The schema `rfsm` as texts of SQL: tables, a function in PL/Lua, functions in SQL.
--
-- When the script is loaded, tables that exist are kept, and functions are replaced. A
-- schema of an older release is altered step by step. Tables that do not change are not
-- locked, so clients need not wait for the load. `rfsm.postgres.script` replaces words
-- such as $TAG.
--
-- @module rfsm.postgres.schema
-- @license BSD-3-Clause

local verbs = require "rfsm.server.verbs"

local ipairs, concat = ipairs, table.concat

local schema = {}

-- The steps from one version of the schema to the next. Each has the table that it
-- changes, and the statement. A schema without a version is of the first one or of the
-- second, so these steps must do no harm to a schema that needs them not.
local STEPS = {
  { "rfsm.out", "ALTER TABLE rfsm.out ADD COLUMN IF NOT EXISTS due timestamptz, "
    .. "ADD COLUMN IF NOT EXISTS tries integer NOT NULL DEFAULT 0, "
    .. "ADD COLUMN IF NOT EXISTS error text; "
    .. "DROP PROCEDURE IF EXISTS rfsm.work(double precision);" },
  { "rfsm.machines", "ALTER TABLE rfsm.machines "
    .. "ADD COLUMN IF NOT EXISTS leases integer NOT NULL DEFAULT 0;" },
  { "rfsm.history", "CREATE INDEX IF NOT EXISTS history_at ON rfsm.history (at);" },
  { "rfsm.history", "ALTER TABLE rfsm.history "
    .. "ADD COLUMN IF NOT EXISTS snapshot jsonb;" },
}

-- The version of the schema is in its comment, which a dump keeps.
local VERSION = #STEPS + 1

-- Locks a table that is to change. Clients have to wait behind a session that waits for
-- a lock, so it gives up soon, lets them pass, and tries again.
local LOCK = [[

CREATE OR REPLACE FUNCTION rfsm.lock_table(name text) RETURNS void
  LANGUAGE plpgsql AS $$
BEGIN
  FOR try IN 1..5 LOOP
    BEGIN
      SET LOCAL lock_timeout = '500ms';
      EXECUTE 'LOCK TABLE ' || name;
      RETURN;
    EXCEPTION WHEN lock_not_available THEN
      IF try = 5 THEN
        RAISE EXCEPTION 'rfsm: nothing was loaded: other sessions hold tables that '
          'are to change (pid %); load again when their transactions have ended',
          (SELECT string_agg(DISTINCT pid::text, ', ') FROM pg_locks
            WHERE granted AND pid <> pg_backend_pid() AND relation = name::regclass);
      END IF;
      PERFORM pg_sleep(0.5);
    END;
  END LOOP;
END $$;
]]

local steps = {}
for i, step in ipairs(STEPS) do
  steps[i] = ([[
  IF found <= %d AND to_regclass('%s') IS NOT NULL THEN
    PERFORM rfsm.lock_table('%s');
    %s
  END IF;
]]):format(i, step[1], step[1], step[2])
end

schema.HEAD = [[
-- Made by: rfsm postgres. All of it, or nothing: one transaction.
BEGIN;
SET LOCAL client_min_messages = warning;
CREATE SCHEMA IF NOT EXISTS rfsm;
]] .. LOCK .. [[

-- Alters the tables of an older release.
DO $$
DECLARE found integer := coalesce(substring(obj_description(to_regnamespace('rfsm'),
  'pg_namespace') FROM '^rfsm schema (\d+)$')::integer, 1);
BEGIN
  IF found > ]] .. VERSION .. [[ THEN
    RAISE EXCEPTION 'rfsm: nothing was loaded: the schema is of version %, this script '
      'knows ]] .. VERSION .. [[ (load one of the rfsm that made it)', found;
  END IF;
  IF to_regclass('rfsm.machines') IS NULL THEN RETURN; END IF;
]] .. concat(steps) .. [[
END $$;
COMMENT ON SCHEMA rfsm IS 'rfsm schema ]] .. VERSION .. [[';

CREATE TABLE IF NOT EXISTS rfsm.machines (
  key text COLLATE "C" PRIMARY KEY,
  chart text COLLATE "C" NOT NULL,
  version text NOT NULL,        -- fingerprint of the structure of the chart
  state text COLLATE "C" NOT NULL, -- FQN of the active leaf
  mode text NOT NULL,           -- active, done, inactive
  since timestamptz NOT NULL,   -- when it came to the state
  event text NOT NULL,          -- by which it came
  due timestamptz,              -- when it is to be woken; leased: the end of the lease
  data jsonb NOT NULL,          -- what the chart keeps, by state
  value jsonb NOT NULL,         -- snapshot, ids of the latest events, events to come
  leases integer NOT NULL DEFAULT 0 -- by workers, since it last came to an end
) WITH (fillfactor = 80);

-- What machines have emitted, for workers: rfsm.take, then rfsm.done or rfsm.fail.
CREATE TABLE IF NOT EXISTS rfsm.out (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  what text NOT NULL,
  data jsonb,
  due timestamptz,              -- a worker has it until then
  tries integer NOT NULL DEFAULT 0,
  error text                    -- the latest one
);

-- Entries that failed too often.
CREATE TABLE IF NOT EXISTS rfsm.dead (
  id bigint PRIMARY KEY,        -- as in rfsm.out
  at timestamptz NOT NULL,
  key text COLLATE "C" NOT NULL,
  what text NOT NULL,
  data jsonb,
  tries integer NOT NULL,
  error text
);

-- Errors of callbacks, and of machines that could not be woken.
CREATE TABLE IF NOT EXISTS rfsm.log (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  error text NOT NULL
);

-- Counters of calls that send events, those whose events were dropped apart.
CREATE SEQUENCE IF NOT EXISTS rfsm.events;
CREATE SEQUENCE IF NOT EXISTS rfsm.dropped;
GRANT USAGE ON SEQUENCE rfsm.events, rfsm.dropped TO PUBLIC;

-- CREATE INDEX IF NOT EXISTS would lock the table even if the index exists.
DO $$ BEGIN
  IF to_regclass('rfsm.log_key') IS NULL THEN
    CREATE INDEX machines_state ON rfsm.machines (chart, state, since);
    CREATE INDEX machines_due ON rfsm.machines (due) WHERE due IS NOT NULL;
    CREATE INDEX log_key ON rfsm.log (key, id);
  END IF;
END $$;

-- Is a state the same as another one, or inside of it?
CREATE OR REPLACE FUNCTION rfsm.is_in(state text, other text)
  RETURNS boolean LANGUAGE sql IMMUTABLE AS $$
  SELECT state = other OR starts_with(state, other || '.')
$$;

-- Is the machine with this column held?
CREATE OR REPLACE FUNCTION rfsm.is_held(value jsonb)
  RETURNS boolean LANGUAGE sql IMMUTABLE AS $$
  SELECT coalesce(jsonb_typeof(value->8) = 'number', false)
$$;
]]

-- For each type of result, the body of a function that makes it; %s is a list of texts.
-- A body in SQL would be parsed anew in each statement that calls it.
local RESULTS = { text = "RETURN (%s)[1]", boolean = "RETURN (%s)[1] = '1'",
  what = "RETURN (SELECT l[1] || ' ' || l[cardinality(l)] FROM %s l)",
  ["SETOF text"] = "RETURN QUERY SELECT unnest(%s)",
  ["TABLE (name text, value text)"] = "RETURN QUERY SELECT l[i], l[i + 1] FROM %s l, "
    .. "generate_series(1, cardinality(l), 2) i" }

-- The functions for one machine. A role that has USAGE of the schema may call them,
-- except those that are revoked below. They run with the rights of the owner ($BY).
local function function_of(name, sql)
  local call = ("rfsm.call('rfsm_%s', key, %s)"):format(name, sql[3] or "NULL, NULL")
  return ([[
CREATE OR REPLACE FUNCTION rfsm.%s(key text%s)
  RETURNS %s $BY AS $$
BEGIN
  %s;
END $$;

]]):format(name, sql[1], sql[2], RESULTS[sql[4] or sql[2]]:format(call))
end

local calls = verbs.map(function(verb)
  local more = verb.more_sql and function_of(verb.name, verb.more_sql) or ""
  return verb.sql and function_of(verb.name, verb.sql) .. more
end)

local revoked = verbs.map(function(verb) return verb.by and "rfsm." .. verb.name end)

schema.FUNCTIONS = [[

CREATE EXTENSION IF NOT EXISTS pllua;

CREATE OR REPLACE FUNCTION rfsm.call(name text, key text, args text[], id text)
  RETURNS text[] LANGUAGE pllua AS $TAG
  return self.answer(name, key, args, id)
end
do
$CODE$TAG;
COMMENT ON FUNCTION rfsm.call IS 'library $ID';
REVOKE EXECUTE ON FUNCTION rfsm.call FROM PUBLIC;

CREATE OR REPLACE FUNCTION rfsm.reply(key text, events text[], id text DEFAULT NULL,
  OUT state text, OUT mode text, OUT errors text[], OUT outcome text) $BY AS $$
DECLARE r text[] := rfsm.call('rfsm_send', key, events, id);
BEGIN
  state := r[1];
  mode := r[2];
  errors := r[3:cardinality(r) - 1];
  outcome := r[cardinality(r)];
END $$;

-- An operator sends an event, and the history has who that is.
CREATE OR REPLACE FUNCTION rfsm.send_by(key text, event text,
  who text DEFAULT session_user, id text DEFAULT NULL) RETURNS text $BY AS $$
BEGIN
  RETURN (rfsm.call('rfsm_send', key, ARRAY[event, 'BY', who],
    coalesce(id, gen_random_uuid()::text)))[1];
END $$;

-- They had fewer parameters.
DROP FUNCTION IF EXISTS rfsm.set(text, text, jsonb, text), rfsm.hold(text),
  rfsm.hold(text, text), rfsm.release(text), rfsm.force(text, text), rfsm.move(text),
  rfsm.remove(text);

]] .. concat(calls) .. [[
REVOKE EXECUTE ON FUNCTION ]] .. concat(revoked, ", ") .. [[, rfsm.send_by FROM PUBLIC;

-- Runs a machine that is due, unless another session has locked it; returns whether it
-- ran. A machine that cannot run waits for a minute, and the log has the reason.
CREATE OR REPLACE FUNCTION rfsm.run_due(key text) RETURNS boolean $BY AS $$
#variable_conflict use_column
DECLARE each text := key;
BEGIN
  PERFORM FROM rfsm.leased(each);
  IF NOT FOUND THEN RETURN false; END IF;
  PERFORM rfsm.call('rfsm_tick', each, '{due}', NULL);
  RETURN true;
EXCEPTION
  WHEN lock_not_available OR deadlock_detected OR serialization_failure THEN
    RETURN false;
  WHEN OTHERS THEN
    UPDATE rfsm.machines SET due = now() + interval '1 minute', leases = 0
      WHERE key = each;
    $LOG;
    RETURN false;
END $$;

-- Runs machines that are due, all in one transaction; returns how many. If a statement
-- timeout or a user ends a machine that comes to no end, nothing has run, and this
-- machine gets a lease as from a worker, so that the next call runs the others.
CREATE OR REPLACE FUNCTION rfsm.wake(most integer DEFAULT 100) RETURNS integer $BY AS $$
DECLARE
  each text;
  woken integer := 0;
  count integer;
BEGIN
  FOREACH each IN ARRAY ARRAY(SELECT m.key FROM rfsm.machines m WHERE m.due <= now()
    ORDER BY m.due LIMIT most FOR UPDATE SKIP LOCKED)
  LOOP
    IF rfsm.run_due(each) THEN woken := woken + 1; END IF;
  END LOOP;
  RETURN woken;
EXCEPTION WHEN query_canceled THEN
  UPDATE rfsm.machines m SET leases = m.leases + 1,
    due = clock_timestamp() + interval '$SECONDS s'
  WHERE m.key = each RETURNING m.leases INTO count;
  RAISE WARNING 'rfsm.wake: % was cancelled, so nothing has run: call it again',
    coalesce(each, 'the search');
  IF count >= $MOST THEN
    PERFORM rfsm.call('rfsm_hold', each, ARRAY['$REASON'], NULL);
  END IF;
  RETURN 0;
END $$;

-- Runs the machine that the transaction before has leased, if any, and leases the next
-- one. A machine that had too many leases is held.
CREATE OR REPLACE FUNCTION rfsm.next_due(INOUT leased text, OUT has_run boolean) $BY
  AS $$
DECLARE count integer;
BEGIN
  has_run := leased IS NOT NULL AND rfsm.run_due(leased);
  LOOP
    SELECT l.key, l.leases INTO leased, count FROM rfsm.lease() l;
    EXIT WHEN leased IS NULL OR count <= $MOST;
    BEGIN
      PERFORM rfsm.call('rfsm_hold', leased, ARRAY['$REASON'], NULL);
    EXCEPTION WHEN OTHERS THEN
      UPDATE rfsm.machines SET due = now() + interval '1 minute' WHERE key = leased;
    END;
  END LOOP;
END $$;

-- A worker: it runs machines that are due, each in a transaction, and leases each in
-- the transaction before, until it is cancelled. If there is a statement_timeout, it
-- ends when half of it has passed, so that the other half is there for each machine. It
-- sends a line to its client now and then: the server ends the session if the client is
-- gone.
CREATE OR REPLACE PROCEDURE rfsm.work(pause double precision DEFAULT 0.1,
  report interval DEFAULT '30 seconds') LANGUAGE plpgsql AS $$
DECLARE
  leased text;
  has_run boolean;
  total bigint := 0;
  next_report timestamptz := clock_timestamp() + report;
  last timestamptz := statement_timestamp() + (SELECT nullif(setting, '0')::integer / 2
    * interval '1 ms' FROM pg_settings WHERE name = 'statement_timeout');
BEGIN
  LOOP
    COMMIT;
    SET TRANSACTION ISOLATION LEVEL READ COMMITTED;
    BEGIN
      SELECT * INTO leased, has_run FROM rfsm.next_due(leased);
    EXCEPTION
      WHEN lock_not_available OR deadlock_detected OR serialization_failure THEN
        leased := NULL;
        has_run := false;
    END;
    total := total + has_run::integer;
    IF clock_timestamp() >= next_report THEN
      RAISE INFO 'rfsm.work: % machines were woken', total;
      $TRIM
      next_report := clock_timestamp() + report;
    END IF;
    IF clock_timestamp() >= last THEN
      COMMIT;
      has_run := leased IS NOT NULL AND rfsm.run_due(leased);
      EXIT;
    END IF;
    IF leased IS NULL THEN
      COMMIT;
      PERFORM pg_sleep(pause);
    END IF;
  END LOOP;
END $$;

-- A chart that was left out by mistake looks like good news until its machines are due.
DO $$
DECLARE gone text := (SELECT string_agg(DISTINCT chart, ', ') FROM rfsm.machines
  WHERE chart <> ALL (ARRAY[$NAMES]));
BEGIN
  IF gone <> '' THEN
    RAISE WARNING 'the machines of % cannot run until it is loaded, too', gone;
  END IF;
END $$;
]]

schema.OUTBOX = [[

-- Leases the machine that is due first: no other worker runs it until the lease is
-- over. `leases` counts the leases since the machine last came to an end.
CREATE OR REPLACE FUNCTION rfsm.lease(OUT key text, OUT leases integer) $OWNER AS $$
  UPDATE rfsm.machines m SET leases = m.leases + 1,
    due = clock_timestamp() + interval '$SECONDS s'
  WHERE m.key = (SELECT n.key FROM rfsm.machines n WHERE n.due <= now()
    ORDER BY n.due LIMIT 1 FOR UPDATE SKIP LOCKED)
  RETURNING m.key, m.leases
$$;

-- Locks a leased machine. Another worker that looks for one may hold it for a moment.
-- If a session holds it for longer, there is no row, and the lease passes.
CREATE OR REPLACE FUNCTION rfsm.leased(machine text)
  RETURNS TABLE (key text, value jsonb) LANGUAGE plpgsql
  SET search_path = pg_catalog, pg_temp SET lock_timeout = '1s' AS $$
BEGIN
  RETURN QUERY SELECT m.key, m.value FROM rfsm.machines m WHERE m.key = machine
    FOR UPDATE;
EXCEPTION WHEN lock_not_available OR deadlock_detected OR serialization_failure THEN
  RETURN;
END $$;

-- Returns entries that no other worker has, and counts the try. A worker has an entry
-- for the time of the lease, twice as long with each further try; then another worker
-- may take it. First, entries that have no try left are moved to rfsm.dead.
CREATE OR REPLACE FUNCTION rfsm.take(most integer DEFAULT 1,
  lease interval DEFAULT '30 seconds', max_tries integer DEFAULT 5)
  RETURNS TABLE (id bigint, key text, what text, data jsonb, try integer) $OWNER AS $$
  WITH dead AS (
    DELETE FROM rfsm.out o WHERE o.id IN (SELECT d.id FROM rfsm.out d
      WHERE d.tries >= max_tries AND d.due <= clock_timestamp()
      FOR UPDATE SKIP LOCKED) RETURNING o.*)
  INSERT INTO rfsm.dead SELECT d.id, d.at, d.key, d.what, d.data, d.tries,
    coalesce(d.error, 'no worker has finished it') FROM dead d;
  UPDATE rfsm.out o SET tries = o.tries + 1,
    due = clock_timestamp() + lease * power(2, o.tries)
  WHERE o.id IN (SELECT n.id FROM rfsm.out n
    WHERE coalesce(n.due <= clock_timestamp(), true) AND n.tries < max_tries
    ORDER BY n.id LIMIT most FOR UPDATE SKIP LOCKED)
  RETURNING o.id, o.key, o.what, o.data, o.tries;
$$;

-- Removes an entry that is done: call it in the transaction that sends the answer.
-- Returns whether the entry was there.
CREATE OR REPLACE FUNCTION rfsm.done(id bigint) RETURNS boolean $OWNER AS $$
  WITH gone AS (DELETE FROM rfsm.out o WHERE o.id = done.id RETURNING 1)
  SELECT EXISTS (SELECT FROM gone)
$$;

-- The try has failed: the entry may be taken again when its lease is over. Returns
-- whether the entry was there.
CREATE OR REPLACE FUNCTION rfsm.fail(id bigint, reason text)
  RETURNS boolean $OWNER AS $$
  WITH failed AS (UPDATE rfsm.out o SET error = reason WHERE o.id = fail.id RETURNING 1)
  SELECT EXISTS (SELECT FROM failed)
$$;

-- Sends a dead entry again, or drops it. Returns whether the entry was there. It keeps
-- its id, so that an answer which was sent before it failed counts once.
CREATE OR REPLACE FUNCTION rfsm.again(id bigint) RETURNS boolean $OWNER AS $$
  WITH gone AS (DELETE FROM rfsm.dead d WHERE d.id = again.id RETURNING *),
    sent AS (INSERT INTO rfsm.out (id, at, key, what, data) OVERRIDING SYSTEM VALUE
      SELECT g.id, g.at, g.key, g.what, g.data FROM gone g RETURNING 1)
  SELECT EXISTS (SELECT FROM sent)
$$;

CREATE OR REPLACE FUNCTION rfsm.drop(id bigint) RETURNS boolean $OWNER AS $$
  WITH gone AS (DELETE FROM rfsm.dead d WHERE d.id = "drop".id RETURNING 1)
  SELECT EXISTS (SELECT FROM gone)
$$;

-- What an operator asks: the latest errors of a machine, the machines that are due, how
-- many machines there are of each version, and those that are in a state, for so long.
CREATE OR REPLACE FUNCTION rfsm.log(key text, most integer DEFAULT 10)
  RETURNS TABLE (at timestamptz, error text) $OWNER AS $$
  SELECT l.at, l.error FROM rfsm.log l WHERE l.key = log.key ORDER BY l.id DESC
  LIMIT most
$$;

CREATE OR REPLACE FUNCTION rfsm.due(most integer DEFAULT 100,
  until timestamptz DEFAULT clock_timestamp())
  RETURNS TABLE (key text, due timestamptz) $OWNER AS $$
  SELECT m.key, m.due FROM rfsm.machines m WHERE m.due <= until ORDER BY m.due
  LIMIT most
$$;

CREATE OR REPLACE FUNCTION rfsm.versions()
  RETURNS TABLE (chart text, version text, machines bigint) $OWNER AS $$
  SELECT m.chart, m.version, count(*) FROM rfsm.machines m GROUP BY 1, 2 ORDER BY 1, 2
$$;

-- A misspelt name must not look like good news, so there is a warning then.
CREATE OR REPLACE FUNCTION rfsm.find(chart text, state text, most integer DEFAULT 100,
  age interval DEFAULT '0') RETURNS SETOF text $BY AS $$
DECLARE hint text;
BEGIN
  RETURN QUERY SELECT m.key FROM rfsm.machines m WHERE m.chart = find.chart
    AND rfsm.is_in(m.state, find.state) AND m.since <= clock_timestamp() - age
  ORDER BY m.since LIMIT most;
  IF NOT FOUND AND to_regproc('rfsm.call') IS NOT NULL THEN
    hint := (rfsm.call('rfsm_hint', NULL, ARRAY[find.chart, find.state], NULL))[1];
    IF hint <> '' THEN
      RAISE WARNING 'rfsm.find: no machine of chart ''%'' is in ''%''%', find.chart,
        find.state, hint;
    END IF;
  END IF;
END $$;

-- Numbers for monitoring.
CREATE OR REPLACE FUNCTION rfsm.stats()
  RETURNS TABLE (name text, chart text, state text, value bigint) $OWNER AS $$
  SELECT 'rfsm_machines', m.chart, m.state, count(*) FROM rfsm.machines m
    GROUP BY m.chart, m.state
  UNION ALL SELECT 'rfsm_timers', NULL, NULL, count(due) FROM rfsm.machines
  UNION ALL SELECT 'rfsm_overdue', NULL, NULL, count(*) FROM rfsm.machines
    WHERE due < clock_timestamp() - interval '1 minute'
  UNION ALL SELECT 'rfsm_aside', NULL, NULL, count(*) FROM rfsm.machines m
    WHERE m.value->9->>1 = '$REASON' -- held by a worker
  UNION ALL SELECT 'rfsm_entries', NULL, NULL, count(*) FROM rfsm.out
  UNION ALL SELECT 'rfsm_dead', NULL, NULL, count(*) FROM rfsm.dead
  ORDER BY 1, 2, 3
$$;

-- The same and more for Prometheus, as lines. Counters are those of sequences, which no
-- transaction takes back. Labels are in quotes as in JSON.
CREATE OR REPLACE FUNCTION rfsm.metrics() RETURNS SETOF text $OWNER AS $$
  WITH found (name, labels, value) AS (
    SELECT s.name, CASE WHEN s.chart IS NOT NULL THEN format('{chart=%s,state=%s}',
      to_json(s.chart), to_json(s.state)) END, s.value::numeric FROM rfsm.stats() s
    UNION ALL SELECT 'rfsm_version_machines', format('{chart=%s,version=%s}',
      to_json(v.chart), to_json(v.version)), v.machines FROM rfsm.versions() v
    UNION ALL SELECT 'rfsm_oldest_entry_seconds', NULL, coalesce(round(extract(
      epoch FROM clock_timestamp() - min(at))::numeric, 3), 0) FROM rfsm.out
    UNION ALL SELECT 'rfsm_oldest_timer_seconds', NULL, greatest(coalesce(round(extract(
      epoch FROM clock_timestamp() - min(due))::numeric, 3), 0), 0) FROM rfsm.machines
    UNION ALL SELECT 'rfsm_events_total', NULL,
      coalesce(pg_sequence_last_value('rfsm.events'), 0)
      + coalesce(pg_sequence_last_value('rfsm.dropped'), 0)
    UNION ALL SELECT 'rfsm_dropped_total', NULL,
      coalesce(pg_sequence_last_value('rfsm.dropped'), 0)
    UNION ALL SELECT 'rfsm_errors_total', NULL,
      coalesce(pg_sequence_last_value(pg_get_serial_sequence('rfsm.log',
        'id')::regclass), 0)),
  lines AS (
    SELECT DISTINCT name, 0 AS rank, NULL AS labels, '# TYPE ' || name
      || CASE WHEN name LIKE '%\_total' THEN ' counter' ELSE ' gauge' END AS line
      FROM found
    UNION ALL SELECT name, 1, labels, concat(name, labels, ' ', value) FROM found)
  SELECT line FROM lines ORDER BY name COLLATE "C", rank, labels COLLATE "C"
$$;

-- Removes what is older from the history, if there is one; returns how many moves.
CREATE OR REPLACE FUNCTION rfsm.trim(age interval) RETURNS bigint $BY AS $$
DECLARE count bigint := 0;
BEGIN
  IF to_regclass('rfsm.history') IS NOT NULL THEN
    DELETE FROM rfsm.history WHERE at < clock_timestamp() - age;
    GET DIAGNOSTICS count = ROW_COUNT;
  END IF;
  RETURN count;
END $$;

REVOKE EXECUTE ON FUNCTION rfsm.take, rfsm.done, rfsm.fail, rfsm.again, rfsm.drop,
  rfsm.metrics, rfsm.trim, rfsm.stats, rfsm.log, rfsm.due, rfsm.versions, rfsm.find
  FROM PUBLIC;
]]

schema.HISTORY = [[

CREATE TABLE IF NOT EXISTS rfsm.history (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  event text,
  src text COLLATE "C",         -- NULL: the machine is new
  tgt text COLLATE "C",         -- NULL: the machine was deleted
  snapshot jsonb                -- after it; NULL: a later move of the call has one
);
DO $$ BEGIN
  IF to_regclass('rfsm.history_key') IS NULL THEN
    CREATE INDEX history_key ON rfsm.history (key, id);
    CREATE INDEX history_at ON rfsm.history (at);
  END IF;
END $$;

-- OLD is empty for a new machine, NEW for one that is deleted.
CREATE OR REPLACE FUNCTION rfsm.note() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  INSERT INTO rfsm.history (key, event, src, tgt, snapshot)
    VALUES (coalesce(NEW.key, OLD.key), NEW.event, OLD.state, NEW.state,
      CASE WHEN NEW.value IS DISTINCT FROM OLD.value THEN NEW.value->2 END);
  RETURN NULL;
END $$;
]]

schema.NOTIFY = [[

CREATE OR REPLACE FUNCTION rfsm.notify() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  PERFORM pg_notify('rfsm', json_build_object('key', NEW.key, 'chart', NEW.chart,
    'state', NEW.state)::text);
  RETURN NULL;
END $$;
]]

schema.TRIGGERS = [[

-- Makes the triggers that are absent or different, and drops those that are not wanted.
-- Both need a lock of the table.
DO $$
DECLARE
  moved text := 'WHEN ((old.state <> new.state)) ';
  each record;
BEGIN
  FOR each IN
    SELECT name, replace(pg_get_triggerdef(t.oid), 'FUNCTION n',
      'FUNCTION rfsm.n') AS found, -- it lacks a schema that is in search_path
      CASE WHEN is_wanted THEN format('CREATE TRIGGER %s AFTER %s ON rfsm.machines '
        'FOR EACH ROW %sEXECUTE FUNCTION rfsm.%s()', name, event, condition, f)
      END AS wanted
    FROM (VALUES ('note_new', 'INSERT OR DELETE', '', 'note', $HISTORY),
      ('note_move', 'UPDATE', moved, 'note', $HISTORY),
      ('notify_new', 'INSERT', '', 'notify', $NOTIFY),
      ('notify_move', 'UPDATE', moved, 'notify', $NOTIFY))
      AS ours (name, event, condition, f, is_wanted)
    LEFT JOIN pg_trigger t ON tgrelid = 'rfsm.machines'::regclass AND tgname = name
  LOOP
    CONTINUE WHEN each.found IS NOT DISTINCT FROM each.wanted;
    PERFORM rfsm.lock_table('rfsm.machines');
    EXECUTE format('DROP TRIGGER IF EXISTS %s ON rfsm.machines', each.name);
    IF each.wanted IS NOT NULL THEN EXECUTE each.wanted; END IF;
  END LOOP;
END $$;
]]

schema.FOOT = "\nDROP FUNCTION rfsm.lock_table;\nCOMMIT;\n"

return schema
