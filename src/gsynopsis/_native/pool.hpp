// Threads that share work and sleep between calls.
//
// OpenMP's threads spin at every barrier and wait for the last of them, so that one busy process
// beside a training made it several times slower. Here the caller works too. Each thread begins
// with items next to each other, whose memory its core then holds, and goes on with what others
// have not come to: a thread that wakes late finds nothing left and holds up nobody.
#pragma once

#include <cstdint>

namespace gsyn {

namespace pool {
using Work = void (*)(const void *context, int64_t item, int worker);
void run(int64_t items, int threads, Work work, const void *context);
}  // namespace pool

// Calls work(item, worker) once for each item in [0, items), on at most `threads` threads, and
// returns when all are done. The caller is worker 0; no two threads are the same worker. `work`
// must not throw, and what it writes must not depend on the worker.
template <class F>
void share(int64_t items, int threads, const F &work) {
    pool::run(
        items, threads,
        [](const void *context, int64_t item, int worker) {
            (*static_cast<const F *>(context))(item, worker);
        },
        &work);
}

}  // namespace gsyn
