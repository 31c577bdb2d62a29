-- The script that `rfsm postgres order=ORDER --history --notify` of cb842e9a wrote, without the
-- library in rfsm.call, and the machines that it made, at the time 1700000000.
-- Made by: rfsm postgres. All of it, or nothing: one transaction.
BEGIN;
SET LOCAL client_min_messages = warning;
CREATE SCHEMA IF NOT EXISTS rfsm;

CREATE TABLE IF NOT EXISTS rfsm.machines (
  key text COLLATE "C" PRIMARY KEY,
  chart text COLLATE "C" NOT NULL,
  version text NOT NULL,        -- fingerprint of the structure of the chart
  state text COLLATE "C" NOT NULL, -- FQN of the active leaf
  mode text NOT NULL,           -- active, done, inactive
  since timestamptz NOT NULL,   -- when it came to the state
  event text NOT NULL,          -- by which it came
  due timestamptz,              -- when it is to be woken
  data jsonb NOT NULL,          -- what the chart keeps, by state
  value jsonb NOT NULL          -- snapshot, ids of the latest events, events to come
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

CREATE EXTENSION IF NOT EXISTS pllua;

CREATE OR REPLACE FUNCTION rfsm.call(name text, key text, args text[], id text)
  RETURNS text[] LANGUAGE pllua AS $rfsm$
  return nil -- here was the library
$rfsm$;
COMMENT ON FUNCTION rfsm.call IS 'library 809785-65e80';
REVOKE EXECUTE ON FUNCTION rfsm.call FROM PUBLIC;

CREATE OR REPLACE FUNCTION rfsm.reply(key text, events text[], id text DEFAULT NULL,
  OUT state text, OUT mode text, OUT errors text[], OUT outcome text) LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT r[1], r[2], r[3:cardinality(r) - 1], r[cardinality(r)]
  FROM rfsm.call('rfsm_send', key, events, id) r
$$;

CREATE OR REPLACE FUNCTION rfsm.create(key text, chart text, data jsonb DEFAULT '{}', id text DEFAULT NULL)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_create', key, ARRAY[chart, coalesce(data, '{}')::text], id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send(key text, events text[], id text DEFAULT NULL)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_send', key, events, id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send(key text, event text, id text DEFAULT NULL)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_send', key, ARRAY[event], id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send_at(key text, at timestamptz, event text, id text)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_send_at', key, ARRAY[extract(epoch FROM at)::text, event], id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.cancel(key text, id text)
  RETURNS boolean LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_cancel', key, ARRAY[id], NULL))[1] = '1'
$$;

CREATE OR REPLACE FUNCTION rfsm.why(key text, event text)
  RETURNS SETOF text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT unnest(rfsm.call('rfsm_why', key, ARRAY[event], NULL))
$$;

CREATE OR REPLACE FUNCTION rfsm.force(key text, state text)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_force', key, ARRAY[state], NULL))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.tick(key text)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_tick', key, NULL, NULL))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.hold(key text)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_hold', key, NULL, NULL))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.release(key text)
  RETURNS text LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_release', key, NULL, NULL))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.remove(key text)
  RETURNS boolean LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT (rfsm.call('rfsm_remove', key, NULL, NULL))[1] = '1'
$$;

REVOKE EXECUTE ON FUNCTION rfsm.hold, rfsm.release, rfsm.force, rfsm.remove FROM PUBLIC;

-- Runs machines that are due and that no other session has locked; returns how many. A
-- machine that cannot run waits for a minute, and the log has the reason.
CREATE OR REPLACE FUNCTION rfsm.wake(most integer DEFAULT 100)
  RETURNS integer LANGUAGE plpgsql SECURITY DEFINER
  SET search_path = pg_catalog, pg_temp AS $$
DECLARE
  each text;
  woken integer := 0;
BEGIN
  FOREACH each IN ARRAY ARRAY(SELECT m.key FROM rfsm.machines m WHERE m.due <= now()
    ORDER BY m.due LIMIT most FOR UPDATE SKIP LOCKED)
  LOOP
    BEGIN
      PERFORM rfsm.tick(each);
      woken := woken + 1;
    EXCEPTION
      WHEN lock_not_available OR deadlock_detected OR serialization_failure THEN
        NULL;
      WHEN OTHERS THEN
        UPDATE rfsm.machines SET due = now() + interval '1 minute' WHERE key = each;
        WITH trimmed AS (DELETE FROM rfsm.log WHERE key = each AND id <= (SELECT id
      FROM rfsm.log WHERE key = each ORDER BY id DESC OFFSET 999 LIMIT 1))
    INSERT INTO rfsm.log (key, error) VALUES (each, SQLERRM);
    END;
  END LOOP;
  RETURN woken;
END $$;

-- A worker: it wakes machines until it is cancelled, each batch in a transaction. It
-- sends a line to its client now and then: the server ends the session if the client is
-- gone.
CREATE OR REPLACE PROCEDURE rfsm.work(pause double precision DEFAULT 0.1,
  report interval DEFAULT '30 seconds') LANGUAGE plpgsql AS $$
DECLARE
  woken integer;
  total bigint := 0;
  next_report timestamptz := clock_timestamp() + report;
BEGIN
  LOOP
    COMMIT;
    SET TRANSACTION ISOLATION LEVEL READ COMMITTED;
    BEGIN
      woken := rfsm.wake();
    EXCEPTION
      WHEN lock_not_available OR deadlock_detected OR serialization_failure THEN
        woken := 0;
    END;
    total := total + woken;
    IF clock_timestamp() >= next_report THEN
      RAISE INFO 'rfsm.work: % machines were woken', total;
      next_report := clock_timestamp() + report;
    END IF;
    IF woken = 0 THEN
      COMMIT;
      PERFORM pg_sleep(pause);
    END IF;
  END LOOP;
END $$;

-- Returns entries that no other worker has, and counts the try. A worker has an entry
-- for the time of the lease, twice as long with each further try; then another worker
-- may take it. First, entries that have no try left are moved to rfsm.dead.
CREATE OR REPLACE FUNCTION rfsm.take(most integer DEFAULT 1,
  lease interval DEFAULT '30 seconds', max_tries integer DEFAULT 5)
  RETURNS TABLE (id bigint, key text, what text, data jsonb, try integer) LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
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
CREATE OR REPLACE FUNCTION rfsm.done(id bigint) RETURNS boolean LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  WITH gone AS (DELETE FROM rfsm.out o WHERE o.id = done.id RETURNING 1)
  SELECT EXISTS (SELECT FROM gone)
$$;

-- The try has failed: the entry may be taken again when its lease is over. Returns
-- whether the entry was there.
CREATE OR REPLACE FUNCTION rfsm.fail(id bigint, reason text)
  RETURNS boolean LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  WITH failed AS (UPDATE rfsm.out o SET error = reason WHERE o.id = fail.id RETURNING 1)
  SELECT EXISTS (SELECT FROM failed)
$$;

-- Sends a dead entry again, or drops it. Returns whether the entry was there.
CREATE OR REPLACE FUNCTION rfsm.again(id bigint) RETURNS boolean LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  WITH gone AS (DELETE FROM rfsm.dead d WHERE d.id = again.id RETURNING *),
    sent AS (INSERT INTO rfsm.out (key, what, data)
      SELECT key, what, data FROM gone RETURNING 1)
  SELECT EXISTS (SELECT FROM sent)
$$;

CREATE OR REPLACE FUNCTION rfsm.drop(id bigint) RETURNS boolean LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  WITH gone AS (DELETE FROM rfsm.dead d WHERE d.id = "drop".id RETURNING 1)
  SELECT EXISTS (SELECT FROM gone)
$$;

-- Numbers for monitoring.
CREATE OR REPLACE FUNCTION rfsm.stats()
  RETURNS TABLE (name text, chart text, state text, value bigint) LANGUAGE sql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
  SELECT 'rfsm_machines', m.chart, m.state, count(*) FROM rfsm.machines m
    GROUP BY m.chart, m.state
  UNION ALL SELECT 'rfsm_timers', NULL, NULL, count(due) FROM rfsm.machines
  UNION ALL SELECT 'rfsm_overdue', NULL, NULL, count(*) FROM rfsm.machines
    WHERE due < clock_timestamp() - interval '1 minute'
  UNION ALL SELECT 'rfsm_entries', NULL, NULL, count(*) FROM rfsm.out
  UNION ALL SELECT 'rfsm_dead', NULL, NULL, count(*) FROM rfsm.dead
  ORDER BY 1, 2, 3
$$;

REVOKE EXECUTE ON FUNCTION rfsm.take, rfsm.done, rfsm.fail, rfsm.again, rfsm.drop,
  rfsm.stats FROM PUBLIC;

CREATE TABLE IF NOT EXISTS rfsm.history (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  event text,
  src text COLLATE "C",         -- NULL: the machine is new
  tgt text COLLATE "C"          -- NULL: the machine was deleted
);
DO $$ BEGIN
  IF to_regclass('rfsm.history_key') IS NULL THEN
    CREATE INDEX history_key ON rfsm.history (key, id);
  END IF;
END $$;

CREATE OR REPLACE FUNCTION rfsm.note() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  IF TG_OP = 'DELETE' THEN
    INSERT INTO rfsm.history (key, src) VALUES (OLD.key, OLD.state);
  ELSIF TG_OP = 'INSERT' THEN
    INSERT INTO rfsm.history (key, event, tgt) VALUES (NEW.key, NEW.event, NEW.state);
  ELSE
    INSERT INTO rfsm.history (key, event, src, tgt)
      VALUES (NEW.key, NEW.event, OLD.state, NEW.state);
  END IF;
  RETURN NULL;
END $$;

CREATE OR REPLACE FUNCTION rfsm.notify() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  PERFORM pg_notify('rfsm', json_build_object('key', NEW.key, 'chart', NEW.chart,
    'state', NEW.state)::text);
  RETURN NULL;
END $$;

-- Makes the triggers that are absent or different, and drops those that are not wanted.
-- Both need a lock of the table. Clients have to wait behind a session that waits for a
-- lock, so it gives up soon, lets them pass, and tries again.
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
    FROM (VALUES ('note_new', 'INSERT OR DELETE', '', 'note', true),
      ('note_move', 'UPDATE', moved, 'note', true),
      ('notify_new', 'INSERT', '', 'notify', true),
      ('notify_move', 'UPDATE', moved, 'notify', true))
      AS ours (name, event, condition, f, is_wanted)
    LEFT JOIN pg_trigger t ON tgrelid = 'rfsm.machines'::regclass AND tgname = name
  LOOP
    CONTINUE WHEN each.found IS NOT DISTINCT FROM each.wanted;
    FOR try IN 1..5 LOOP
      BEGIN
        SET LOCAL lock_timeout = '500ms';
        LOCK TABLE rfsm.machines;
        EXIT;
      EXCEPTION WHEN lock_not_available THEN
        IF try = 5 THEN
          RAISE EXCEPTION 'rfsm: nothing was loaded: other sessions hold tables that '
            'are to change (pid %); load again when their transactions have ended',
            (SELECT string_agg(DISTINCT pid::text, ', ') FROM pg_locks
              WHERE granted AND pid <> pg_backend_pid()
              AND relation = 'rfsm.machines'::regclass);
        END IF;
        PERFORM pg_sleep(0.5);
      END;
    END LOOP;
    EXECUTE format('DROP TRIGGER IF EXISTS %s ON rfsm.machines', each.name);
    IF each.wanted IS NOT NULL THEN EXECUTE each.wanted; END IF;
  END LOOP;
END $$;

COMMIT;

INSERT INTO rfsm.machines VALUES ('o:1', 'order', '87e60b6fd7b-c31147', 'root.paid', 'done', '2023-11-14 22:13:20+00', 'e_pay', '2023-11-14 22:13:20+00', '{"root": {"n": 1, "item": "gears"}}', '["rfsm", "order", {"ext": {"timers": {"e_after(3600)@root.paid": 3600}}, "data": {"root": ["%t", "item", "gears", "n", 1]}, "done": true, "leaf": "root.paid", "chart": "87e60b6fd7b-c31147", "version": 2}, 1700000000, 0, 1700003600, ["id1"]]');
INSERT INTO rfsm.machines VALUES ('o:3', 'order', '87e60b6fd7b-c31147', 'root.open', 'done', '2023-11-14 22:13:20+00', '', NULL, '{"root": {"n": 0, "item": ""}}', '["rfsm", "order", {"data": {"root": ["%t", "item", "", "n", 0]}, "done": true, "leaf": "root.open", "chart": "87e60b6fd7b-c31147", "version": 2}]');
INSERT INTO rfsm.machines VALUES ('o:2', 'order', '87e60b6fd7b-c31147', 'root.paid', 'done', '2023-11-14 22:13:20+00', 'e_pay', '2023-11-14 22:13:20+00', '{"root": {"n": 1, "item": "late"}}', '["rfsm", "order", {"ext": {"timers": {"e_after(3600)@root.paid": 3599.998857}}, "data": {"root": ["%t", "item", "late", "n", 1]}, "done": true, "leaf": "root.paid", "chart": "87e60b6fd7b-c31147", "version": 2}, 1700000000, 0, 1700003600, ["id2"], [[4102444800, "for-later", "e_ship"]]]');
INSERT INTO rfsm."out" OVERRIDING SYSTEM VALUE VALUES (1, '2023-11-14 22:13:20+00', 'o:1', 'pick', '{"n": 1, "item": "gears"}', NULL, 0, NULL);
INSERT INTO rfsm."out" OVERRIDING SYSTEM VALUE VALUES (2, '2023-11-14 22:13:20+00', 'o:2', 'pick', '{"n": 1, "item": "late"}', NULL, 0, NULL);

SELECT pg_catalog.setval('rfsm.out_id_seq', 2, true);
