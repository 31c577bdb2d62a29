-- The script that `rfsm postgres order=ORDER --history --notify` of c370481 wrote, without the
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
CREATE INDEX IF NOT EXISTS machines_state ON rfsm.machines (chart, state, since);
CREATE INDEX IF NOT EXISTS machines_due ON rfsm.machines (due) WHERE due IS NOT NULL;

-- What machines have emitted, for workers to do and delete.
CREATE TABLE IF NOT EXISTS rfsm.out (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  what text NOT NULL,
  data jsonb
);

-- Errors of callbacks, and of machines that could not be woken.
CREATE TABLE IF NOT EXISTS rfsm.log (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  error text NOT NULL
);
CREATE INDEX IF NOT EXISTS log_key ON rfsm.log (key, id);

-- Is a state another one, or in it?
CREATE OR REPLACE FUNCTION rfsm.is_in(state text, other text)
  RETURNS boolean LANGUAGE sql IMMUTABLE AS $$
  SELECT state = other OR starts_with(state, other || '.')
$$;

CREATE EXTENSION IF NOT EXISTS pllua;

CREATE OR REPLACE FUNCTION rfsm.call(name text, key text, args text[], id text)
  RETURNS text[] LANGUAGE pllua AS $rfsm$
  return nil -- here was the library
$rfsm$;
COMMENT ON FUNCTION rfsm.call IS 'library ddabd4-5db01';

CREATE OR REPLACE FUNCTION rfsm.create(key text, chart text, data jsonb DEFAULT '{}',
  id text DEFAULT NULL) RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_create', key, ARRAY[chart, coalesce(data, '{}')::text],
    id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send(key text, events text[], id text DEFAULT NULL)
  RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_send', key, events, id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send(key text, event text, id text DEFAULT NULL)
  RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_send', key, ARRAY[event], id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send_at(key text, at timestamptz, event text, id text)
  RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_send_at', key, ARRAY[extract(epoch FROM at)::text, event],
    id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.cancel(key text, id text)
  RETURNS boolean LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_cancel', key, ARRAY[id], NULL))[1] = '1'
$$;

CREATE OR REPLACE FUNCTION rfsm.tick(key text) RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_tick', key, NULL, NULL))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.why(key text, event text)
  RETURNS SETOF text LANGUAGE sql AS $$
  SELECT unnest(rfsm.call('rfsm_why', key, ARRAY[event], NULL))
$$;

-- Runs machines that are due and that no other worker has; returns how many. One that
-- cannot run waits for a minute, and the log has the reason.
CREATE OR REPLACE FUNCTION rfsm.wake(most integer DEFAULT 100)
  RETURNS integer LANGUAGE plpgsql AS $$
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
    EXCEPTION WHEN OTHERS THEN
      UPDATE rfsm.machines SET due = now() + interval '1 minute' WHERE key = each;
      INSERT INTO rfsm.log (key, error) VALUES (each, SQLERRM);
    END;
  END LOOP;
  RETURN woken;
END $$;

-- A worker that wakes machines until it is cancelled, each batch in a transaction.
CREATE OR REPLACE PROCEDURE rfsm.work(pause double precision DEFAULT 0.1)
  LANGUAGE plpgsql AS $$
BEGIN
  LOOP
    IF rfsm.wake() = 0 THEN
      COMMIT;
      PERFORM pg_sleep(pause);
    END IF;
    COMMIT;
  END LOOP;
END $$;

DROP TRIGGER IF EXISTS note_new ON rfsm.machines;
DROP TRIGGER IF EXISTS note_move ON rfsm.machines;
DROP TRIGGER IF EXISTS notify_new ON rfsm.machines;
DROP TRIGGER IF EXISTS notify_move ON rfsm.machines;

CREATE TABLE IF NOT EXISTS rfsm.history (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  event text,
  src text COLLATE "C",         -- NULL: the machine is new
  tgt text COLLATE "C"          -- NULL: the machine was deleted
);
CREATE INDEX IF NOT EXISTS history_key ON rfsm.history (key, id);

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
CREATE TRIGGER note_new AFTER INSERT OR DELETE ON rfsm.machines
  FOR EACH ROW EXECUTE FUNCTION rfsm.note();
CREATE TRIGGER note_move AFTER UPDATE ON rfsm.machines
  FOR EACH ROW WHEN (OLD.state <> NEW.state) EXECUTE FUNCTION rfsm.note();

CREATE OR REPLACE FUNCTION rfsm.notify() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  PERFORM pg_notify('rfsm', json_build_object('key', NEW.key, 'chart', NEW.chart,
    'state', NEW.state)::text);
  RETURN NULL;
END $$;
CREATE TRIGGER notify_new AFTER INSERT ON rfsm.machines
  FOR EACH ROW EXECUTE FUNCTION rfsm.notify();
CREATE TRIGGER notify_move AFTER UPDATE ON rfsm.machines
  FOR EACH ROW WHEN (OLD.state <> NEW.state) EXECUTE FUNCTION rfsm.notify();

COMMIT;

INSERT INTO rfsm.machines VALUES ('o:1', 'order', '87e60b6fd7b-c31147', 'root.paid', 'done', '2023-11-14 22:13:20+00', 'e_pay', '2023-11-14 22:13:20+00', '{"root": {"n": 1, "item": "gears"}}', '["rfsm", "order", {"ext": {"timers": {"e_after(3600)@root.paid": 3600}}, "data": {"root": ["%t", "item", "gears", "n", 1]}, "done": true, "leaf": "root.paid", "chart": "87e60b6fd7b-c31147", "version": 2}, 1700000000, 0, 1700003600, ["id1"]]');
INSERT INTO rfsm.machines VALUES ('o:3', 'order', '87e60b6fd7b-c31147', 'root.open', 'done', '2023-11-14 22:13:20+00', '', NULL, '{"root": {"n": 0, "item": ""}}', '["rfsm", "order", {"data": {"root": ["%t", "item", "", "n", 0]}, "done": true, "leaf": "root.open", "chart": "87e60b6fd7b-c31147", "version": 2}]');
INSERT INTO rfsm.machines VALUES ('o:2', 'order', '87e60b6fd7b-c31147', 'root.paid', 'done', '2023-11-14 22:13:20+00', 'e_pay', '2023-11-14 22:13:20+00', '{"root": {"n": 1, "item": "late"}}', '["rfsm", "order", {"ext": {"timers": {"e_after(3600)@root.paid": 3599.999231}}, "data": {"root": ["%t", "item", "late", "n", 1]}, "done": true, "leaf": "root.paid", "chart": "87e60b6fd7b-c31147", "version": 2}, 1700000000, 0, 1700003600, ["id2"], [[4102444800, "for-later", "e_ship"]]]');
INSERT INTO rfsm."out" OVERRIDING SYSTEM VALUE VALUES (1, '2023-11-14 22:13:20+00', 'o:1', 'pick', '{"n": 1, "item": "gears"}');
INSERT INTO rfsm."out" OVERRIDING SYSTEM VALUE VALUES (2, '2023-11-14 22:13:20+00', 'o:2', 'pick', '{"n": 1, "item": "late"}');

SELECT pg_catalog.setval('rfsm.out_id_seq', 2, true);
