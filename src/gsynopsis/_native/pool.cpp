#include "pool.hpp"

#include <unistd.h>

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>

namespace gsyn::pool {
namespace {

constexpr int RANGES_MAX = 64;

// Items next to each other: who begins here goes on here, where the caches hold what is needed.
struct alignas(64) Range {
    std::atomic<int64_t> next;
    int64_t end;
};

class Job {
public:
    Job(int64_t items, int threads, Work work, const void *context)
        : work_(work), context_(context), count_(threads < RANGES_MAX ? threads : RANGES_MAX) {
        for (int i = 0; i < count_; i++) {
            ranges_[i].next.store(items * i / count_, std::memory_order_relaxed);
            ranges_[i].end = items * (i + 1) / count_;
        }
    }

    // Takes items of the worker's own range, then what others have not come to.
    void take_part(int worker) {
        for (int i = 0; i < count_; i++) {
            Range &range = ranges_[(worker + i) % count_];
            for (int64_t item; (item = range.next.fetch_add(1, std::memory_order_relaxed)) <
                               range.end;) {
                work_(context_, item, worker);
            }
        }
    }

private:
    const Work work_;
    const void *const context_;
    const int count_;
    Range ranges_[RANGES_MAX];
};

class Pool {
public:
    void run(Job &job, int threads) {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            start(threads - 1);
            job_ = &job;
            seats_ = threads - 1 < started_ ? threads - 1 : started_;
            workers_ = 0;
        }
        for (int i = 0; i < threads - 1; i++) called_.notify_one();
        job.take_part(0);
        std::unique_lock<std::mutex> lock(mutex_);
        seats_ = 0;  // who has not come by now need not
        done_.wait(lock, [&] { return active_ == 0; });
    }

    std::mutex in_use;  // by one caller at a time

private:
    // Starts what is missing of `wanted` threads; fewer if the system allows no more.
    void start(int wanted) {
        try {
            for (; started_ < wanted; started_++) std::thread([this] { serve(); }).detach();
        } catch (const std::system_error &) {
        }
    }

    void serve() {
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            called_.wait(lock, [&] { return seats_ > 0; });
            seats_--;
            active_++;
            const int worker = ++workers_;
            Job &job = *job_;
            lock.unlock();
            job.take_part(worker);
            lock.lock();
            if (--active_ == 0) done_.notify_one();
        }
    }

    std::mutex mutex_;
    std::condition_variable called_, done_;
    Job *job_ = nullptr;
    int started_ = 0, seats_ = 0, workers_ = 0, active_ = 0;
};

// Never destroyed: its threads sleep until the process ends. A forked process has none of its
// parent's threads and gets a pool of its own.
Pool &here() {
    static std::mutex choosing;
    static Pool *pool = nullptr;
    static pid_t owner = 0;
    const std::lock_guard<std::mutex> lock(choosing);
    if (!pool || owner != getpid()) {
        pool = new Pool;
        owner = getpid();
    }
    return *pool;
}

}  // namespace

void run(int64_t items, int threads, Work work, const void *context) {
    if (threads > items) threads = static_cast<int>(items);
    if (threads > 1) {
        Pool &pool = here();
        // Another caller has the threads: this one works alone rather than wait.
        const std::unique_lock<std::mutex> lock(pool.in_use, std::try_to_lock);
        if (lock) {
            Job job(items, threads, work, context);
            pool.run(job, threads);
            return;
        }
    }
    for (int64_t item = 0; item < items; item++) work(context, item, 0);
}

}  // namespace gsyn::pool
