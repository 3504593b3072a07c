from headcap.workflow.progress import Progress

START = """Job stats:
job            count
-----------  -------
ingest             2
reconstruct        4
all                1
total              7
""".splitlines()


def job(rule: str, jobid: int, wildcards: str) -> list[str]:
    return [f"rule {rule}:", f"    jobid: {jobid}", f"    wildcards: {wildcards}"]


def done(rule: str, jobid: int, steps: int) -> list[str]:
    return [f"Finished jobid: {jobid} (Rule: {rule})", f"{steps} of 7 steps ({100 * steps // 7}%) done"]


def test_stage_chunk_and_time_left_are_told() -> None:
    now = [0.0]
    progress = Progress(clock=lambda: now[0])

    def follow(lines: list[str]) -> list[str]:
        return [told for line in lines if (told := progress.follow(line))]

    assert follow(START) == []
    assert follow(job("ingest", 1, "session=demo, recording=free_01")) == ["ingest demo, free_01"]
    now[0] = 10.0
    # twice as long as usual; left: one more such job, four chunks of usually 80 s and one job of 5 s, all at that pace
    assert follow(done("ingest", 1, 1)) == ["[1/7] about 11 min 00 s left"]
    follow(job("reconstruct", 2, "session=demo, take=free_01, chunk=000"))
    now[0] = 40.0
    # 40 s of jobs in 40 s; left: ingest 10 s, reconstruct 3 x 30 s, and `all`, usually 5 s, at the pace of 40 s for 85 s
    assert follow(done("reconstruct", 2, 2)) == ["[2/7] about 1 min 42 s left"]


def test_before_the_length_of_takes_is_known_the_time_is_a_least_one() -> None:
    now = [0.0]
    progress = Progress(clock=lambda: now[0])
    for line in [
        *START[:3],
        "ingest             2",
        "evaluate           1",
        "total              3",
        *job("ingest", 1, "session=demo"),
    ]:
        progress.follow(line)
    now[0] = 5.0
    for line in done("ingest", 1, 1)[:1]:
        progress.follow(line)
    assert progress.follow("1 of 3 steps (33%) done") == "[1/3] at least 45 s left"
    assert progress.follow("1 of 9 steps (11%) done").startswith("[1/9] about")


def test_lines_of_stages_are_passed_on_and_others_are_not() -> None:
    progress = Progress()
    assert (
        progress.follow("headcap: reconstruct free_01 frame 3: 120000 points\n") == "reconstruct free_01 frame 3: 120000 points"
    )
    assert progress.follow("Select jobs to execute...\n") is None
    assert progress.time_left() == "time left is not known yet"
