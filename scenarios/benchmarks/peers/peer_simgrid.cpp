// Deliver the broadcasts of a workload in SimGrid, by actors and mailboxes, one message per receiver.
//
// This is a standalone program, which elsewhere.py runs. SimGrid cannot draw a latency for each message. The sender
// therefore waits for the latency before it puts a message into the mailbox. This is also done if the latency is
// constant, because it is faster than a link with a latency.

#include <cmath>
#include <ctime>
#include <iostream>
#include <iterator>
#include <queue>
#include <random>
#include <sstream>
#include <string>
#include <tuple>
#include <vector>

#include <simgrid/s4u.hpp>

namespace sg4 = simgrid::s4u;

struct Told
{
    double turns, tick, mean, cv;
    unsigned seed;
    std::vector<std::vector<size_t>> neighbours;
};

static Told told;
static std::vector<sg4::Mailbox*> boxes;
static std::vector<sg4::Host*> hosts;
static uint64_t delivered = 0;

static void hear(size_t node, long expected)
{
    std::vector<long> table(told.neighbours.size(), -1);
    for (; expected; expected--)
    {
        long* number = boxes[node]->get<long>();
        long& known = table[*number % table.size()];
        known = std::max(known, *number);
        delete number;
        delivered++;
    }
}

static void talk(size_t node)
{
    std::mt19937_64 rng(told.seed + node);
    double variance = std::log1p(told.cv * told.cv);
    std::lognormal_distribution<double> latency(std::log(told.mean) - variance / 2, std::sqrt(variance));
    using Due = std::tuple<double, size_t, long>;
    std::priority_queue<Due, std::vector<Due>, std::greater<Due>> waiting;
    for (long number = node; number < told.turns || !waiting.empty();)
    {
        double turn = number < told.turns ? number * told.tick : INFINITY;
        if (!waiting.empty() && std::get<0>(waiting.top()) < turn)
        {
            auto [when, dst, what] = waiting.top();
            waiting.pop();
            sg4::this_actor::sleep_until(when);
            boxes[dst]->put_init(new long(what), 1)->detach();
            continue;
        }
        sg4::this_actor::sleep_until(turn);
        for (size_t dst : told.neighbours[node])
        {
            waiting.emplace(turn + (told.cv ? latency(rng) : told.mean), dst, number);
        }
        number += told.neighbours.size();
    }
}

int main(int argc, char* argv[])
{
    sg4::Engine engine(&argc, argv);
    std::string line;
    std::getline(std::cin, line);
    std::istringstream(line) >> told.turns >> told.tick >> told.mean >> told.cv >> told.seed;
    while (std::getline(std::cin, line))
    {
        std::istringstream words(line);
        told.neighbours.emplace_back(std::istream_iterator<size_t>(words), std::istream_iterator<size_t>());
    }
    auto* zone = sg4::create_full_zone("zone");
    auto* link = zone->create_link("air", 1e18)->set_sharing_policy(sg4::Link::SharingPolicy::FATPIPE);
    link->set_latency(0.0)->seal();
    for (size_t node = 0; node < told.neighbours.size(); node++)
    {
        hosts.push_back(zone->create_host("host " + std::to_string(node), 1e9)->seal());
    }
    for (size_t node = 0; node < hosts.size(); node++)
    {
        for (size_t dst : told.neighbours[node])
        {
            zone->add_route(hosts[node]->get_netpoint(), hosts[dst]->get_netpoint(), nullptr, nullptr,
                            {sg4::LinkInRoute(link)}, false);
        }
    }
    zone->seal();
    std::vector<long> expected(hosts.size());
    for (long number = 0; number < told.turns; number++)
    {
        for (size_t dst : told.neighbours[number % hosts.size()])
        {
            expected[dst]++;
        }
    }
    for (size_t node = 0; node < hosts.size(); node++)
    {
        boxes.push_back(sg4::Mailbox::by_name(std::to_string(node)));
        boxes[node]->set_receiver(sg4::Actor::create("hear", hosts[node], hear, node, expected[node]));
        sg4::Actor::create("talk", hosts[node], talk, node);
    }
    std::clock_t begin = std::clock();
    engine.run();
    double seconds = double(std::clock() - begin) / CLOCKS_PER_SEC;
    std::cout << "{\"deliveries\": " << delivered << ", \"seconds\": " << seconds << "}" << std::endl;
}
