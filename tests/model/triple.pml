/* The triple buffer of csrc/base/hd_triple.h between one writer and one reader, in runs of any length, under the release and
 * acquire of C11. tests/model/verify.py runs it, and docs/adr/0020 says what it proves.
 *
 * Memory. `middle` is changed by exchanges alone, and each of them reads the change before it. The reader's relaxed load
 * may be behind: it sees the reader's own exchange, or one of the writer's that followed. A buffer is plain memory. What
 * one side did to it last is known to the other only by a release that was acquired:
 *
 *   known_w  bit s: the reader knows of the last write to buffer s      view_w, view_r: what whoever acquires `middle`
 *   known_r  bit s: the writer knows of the last read of buffer s       now gets to know
 *
 * A read without the first, or a write without the second, is a data race, by which a record may be torn. An exchange
 * that does not release carries on what those before it released (a release sequence).
 *
 * Records are numbered, modulo NUMBERS. Mutations are made with -D. */

#define ACQ 1
#define REL 2
#ifndef PUBLISH
#define PUBLISH (ACQ | REL)
#endif
#ifndef ACQUIRE
#define ACQUIRE (ACQ | REL)
#endif
#define NUMBERS 8
#define BIT(s) (1 << (s))
#define ALL 7

byte middle = 1, back = 2, front = 0;
bool fresh = false; /* HD_TRIPLE_NEW of `middle` */
byte known_w = ALL, known_r = ALL, view_w = ALL, view_r = ALL;
byte record[3];
byte newest = 0; /* published so far */
byte held = 0;   /* the newest when the reader acquired last */

inline write_buffer() {
    d_step {
        printf("%d STEP write slot\n", _pid);
        assert(known_r & BIT(back));
        record[back] = (newest + 1) % NUMBERS;
        known_w = known_w & ~BIT(back);
        view_w = view_w & ~BIT(back);
    }
}

inline read_buffer() {
    d_step {
        printf("%d STEP read slot\n", _pid);
        assert(known_w & BIT(front));
        assert(record[front] == held);
        known_r = known_r & ~BIT(front);
        view_r = view_r & ~BIT(front);
    }
}

inline writer_exchange() {
    d_step {
        printf("%d STEP exchange middle acq_rel\n", _pid);
        if
        :: PUBLISH & ACQ -> known_r = known_r | view_r
        :: else
        fi;
        if
        :: PUBLISH & REL -> view_w = ALL; view_r = view_r | known_r
        :: else
        fi;
        old = middle;
        middle = back;
#ifndef MUTATE_NO_NEW
        fresh = true;
#endif
#ifndef MUTATE_KEEP
        back = old;
#endif
        newest = (newest + 1) % NUMBERS;
        old = 0;
    }
}

inline reader_exchange() {
    d_step {
        printf("%d STEP exchange middle acq_rel\n", _pid);
        if
        :: ACQUIRE & ACQ -> known_w = known_w | view_w
        :: else
        fi;
        if
        :: ACQUIRE & REL -> view_r = ALL; view_w = view_w | known_w
        :: else
        fi;
        old = middle;
        middle = front;
#ifndef MUTATE_STAYS_NEW
        fresh = false;
#endif
        front = old;
        held = newest;
        old = 0;
    }
}

active proctype writer() {
    byte old;
    do
    ::
        printf("%d BEGIN publish\n", _pid);
#ifdef MUTATE_LATE
        writer_exchange();
        write_buffer();
#else
        write_buffer();
        writer_exchange();
#endif
        printf("%d END\n", _pid)
    od
}

active proctype reader() {
    byte old;
    bool seen;
    do
    ::
        printf("%d BEGIN acquire\n", _pid);
        atomic {
            printf("%d STEP load middle relaxed\n", _pid);
            if
            :: seen = fresh; assert(fresh || held == newest)
#ifndef PROMPT
            :: seen = false /* behind */
#endif
            fi
        }
        if
        :: seen -> reader_exchange()
#ifdef MUTATE_BLIND
        :: true -> reader_exchange()
#endif
        :: !seen
        fi;
        seen = false;
        read_buffer();
        printf("%d END\n", _pid)
    od
}

/* Each buffer has one owner. */
ltl owned { [] (middle != back && middle != front && back != front && middle < 3 && back < 3 && front < 3) }
/* What is published is taken, or overtaken by what is, by a reader that goes on and to whom stores become visible. */
ltl taken { [] (fresh -> <> !fresh) }
