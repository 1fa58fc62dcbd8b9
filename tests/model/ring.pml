/* The ring of csrc/base/hd_ring.h between one producer and one consumer, in runs of any length, under the release and acquire
 * of C11. tests/model/verify.py runs it, and docs/adr/0020 says what it proves.
 *
 * Memory. An index is stored by one side alone. The other's load may be behind: it sees what it saw last or anything that
 * was stored since; `sent` and `freed` have a bit for each value that was. A slot is plain memory. What one side did to
 * it last is known to the other only by a release that was acquired:
 *
 *   known_w  bit s: the consumer knows of the last write to slot s     view_w[i]: what whoever acquires i from `write`
 *   known_r  bit s: the producer knows of the last read of slot s      gets to know; view_r[i]: from `read`
 *
 * A read without the first, or a write without the second, is a data race, by which a record may be torn.
 *
 * Indices are counted modulo 2 CAPACITY, which tells empty from full; records are numbered modulo NUMBERS. What finds no
 * room is dropped and counted: here it has no number, so that any other loss is a gap. Mutations are made with -D. */

#define ACQ 1
#define REL 2
#ifndef COMMIT
#define COMMIT REL
#endif
#ifndef RELEASE
#define RELEASE REL
#endif
#ifndef LOAD_WRITE
#define LOAD_WRITE ACQ
#endif
#ifndef LOAD_READ
#define LOAD_READ ACQ
#endif
#ifndef CAPACITY
#define CAPACITY 2
#endif
#ifndef ROOM
#define ROOM CAPACITY
#endif
#define INDICES (2 * CAPACITY)
#define NUMBERS (2 * CAPACITY + 1)
#define BIT(s) (1 << (s))
#define ALL (BIT(CAPACITY) - 1)
#define PLUS(i, n) (((i) + (n)) % INDICES)
#define MINUS(i, j) (((i) + INDICES - (j)) % INDICES)
#define SLOT(i) ((i) % CAPACITY)

byte write, read, write_seen, read_seen;
byte known_w = ALL, known_r = ALL;
byte view_w[INDICES], view_r[INDICES];
byte sent = 1, freed = 1;
byte record[CAPACITY];
byte next_in, next_out; /* numbers */
bool took;              /* the consumer's last look gave it something */

inline write_slot(i) {
    d_step {
        printf("%d STEP write slot\n", _pid);
        assert(known_r & BIT(SLOT(i)));
        record[SLOT(i)] = next_in;
        next_in = (next_in + 1) % NUMBERS;
        known_w = known_w & ~BIT(SLOT(i));
        k = 0;
        do
        :: k < INDICES -> view_w[k] = view_w[k] & ~BIT(SLOT(i)); k++
        :: else -> break
        od;
        k = 0
    }
}

inline read_slot(i) {
    d_step {
        printf("%d STEP read slot\n", _pid);
        assert(known_w & BIT(SLOT(i)));
        assert(record[SLOT(i)] == next_out);
        next_out = (next_out + 1) % NUMBERS;
        known_r = known_r & ~BIT(SLOT(i));
        k = 0;
        do
        :: k < INDICES -> view_r[k] = view_r[k] & ~BIT(SLOT(i)); k++
        :: else -> break
        od;
        k = 0
    }
}

inline store_write(i) {
    d_step {
        printf("%d STEP store write release\n", _pid);
        sent = sent | BIT(i);
        if
        :: COMMIT & REL -> view_w[i] = ALL
        :: else -> view_w[i] = 0
        fi;
        write = i
    }
}

inline store_read(i) {
    d_step {
        printf("%d STEP store read release\n", _pid);
        freed = freed | BIT(i);
        if
        :: RELEASE & REL -> view_r[i] = ALL
        :: else -> view_r[i] = 0
        fi;
        read = i
    }
}

/* Anything from what was seen last to the newest; values before it are never seen again. */
inline load_write() {
    atomic {
        printf("%d STEP load write acquire\n", _pid);
#ifdef PROMPT
        k = MINUS(write, write_seen);
#else
        k = 0;
        do
        :: k < MINUS(write, write_seen) -> k++
        :: sent & BIT(PLUS(write_seen, k)) -> break
        od;
#endif
        do
        :: k > 0 -> sent = sent & ~BIT(write_seen); write_seen = PLUS(write_seen, 1); k--
        :: else -> break
        od;
        if
        :: LOAD_WRITE & ACQ -> known_w = known_w | view_w[write_seen]
        :: else
        fi
    }
}

inline load_read() {
    atomic {
        printf("%d STEP load read acquire\n", _pid);
#ifdef PROMPT
        k = MINUS(read, read_seen);
#else
        k = 0;
        do
        :: k < MINUS(read, read_seen) -> k++
        :: freed & BIT(PLUS(read_seen, k)) -> break
        od;
#endif
        do
        :: k > 0 -> freed = freed & ~BIT(read_seen); read_seen = PLUS(read_seen, 1); k--
        :: else -> break
        od;
        if
        :: LOAD_READ & ACQ -> known_r = known_r | view_r[read_seen]
        :: else
        fi
    }
}

/* hd_ring_reserve, hd_ring_commit; where there is no room, hd_ring_drop. */
inline push() {
    printf("%d BEGIN push\n", _pid);
    if
    :: MINUS(write, read_seen) == ROOM -> load_read()
    :: else
    fi;
    if
    :: MINUS(write, read_seen) != ROOM ->
#ifdef MUTATE_EARLY_COMMIT
        store_write(PLUS(write, 1));
        write_slot(PLUS(write, INDICES - 1))
#else
        write_slot(write);
        store_write(PLUS(write, 1))
#endif
    :: else -> printf("%d STEP store dropped relaxed\n", _pid)
    fi;
    printf("%d END\n", _pid)
}

inline push_many(count) {
    printf("%d BEGIN push_many\n", _pid);
    load_read();
    if
    :: count <= ROOM - MINUS(write, read_seen) ->
        n = 0;
        do
        :: n < count -> write_slot(PLUS(write, n)); n++
        :: else -> break
        od;
        n = 0;
        store_write(PLUS(write, count))
    :: else
    fi;
    printf("%d END\n", _pid)
}

/* hd_ring_peek, hd_ring_release. */
inline take() {
    printf("%d BEGIN take\n", _pid);
    if
    :: read == write_seen -> load_write()
    :: else
    fi;
    if
    :: read != write_seen ->
#ifdef MUTATE_EARLY_RELEASE
        store_read(PLUS(read, 1));
        read_slot(PLUS(read, INDICES - 1));
#else
        read_slot(read);
        store_read(PLUS(read, 1));
#endif
        took = true
    :: else
    fi;
    printf("%d END\n", _pid)
}

inline pop_many(most) {
    printf("%d BEGIN pop_many\n", _pid);
    load_write();
    n = MINUS(write_seen, read);
    if
    :: n > most -> n = most
    :: else
    fi;
    if
    :: n > 0 ->
        m = 0;
        do
        :: m < n -> read_slot(PLUS(read, m)); m++
        :: else -> break
        od;
        m = 0;
#ifdef MUTATE_FREE_ALL
        store_read(write_seen);
#else
        store_read(PLUS(read, n));
#endif
        took = true
    :: else
    fi;
    n = 0;
    printf("%d END\n", _pid)
}

init {
    d_step {
        view_w[0] = ALL;
        view_r[0] = ALL
    }
    atomic {
        run producer();
        run consumer()
    }
}

proctype producer() {
    byte k, n;
    do
    :: push()
    :: push_many(1)
    :: push_many(2)
    :: push_many(CAPACITY)
    :: push_many(CAPACITY + 1)
    od
}

proctype consumer() {
    byte k, n, m;
    do
    :: took = false; take()
    :: took = false; pop_many(1)
    :: took = false; pop_many(CAPACITY)
    od
}

/* What was sent is taken, by a consumer that goes on and to whom stores become visible. */
ltl taken { [] (write != read -> <> took) }
