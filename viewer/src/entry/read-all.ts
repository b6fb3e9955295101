/** Read a whole file in memory, everything checked: for tests and for tools. */

import { Assembler } from "../format/assembler";
import { checkLength } from "../format/file-index";
import { Kind } from "../format/layout.gen";

/** The assembler of a file or a prefix of it, all levels that it holds decoded. */
export async function readAll(data: Uint8Array): Promise<Assembler> {
  const assembler = new Assembler(data);
  const { index } = assembler;
  const levels = checkLength(index, data.length);
  for (const chunk of index.chunks) {
    if (chunk.offset + chunk.stored > data.length || chunk.level >= levels) continue;
    if (chunk.kind !== Kind.blocks) {
      await assembler.add(chunk, data.subarray(chunk.offset, chunk.offset + chunk.stored));
      continue;
    }
    for (const page of assembler.pages?.pieces(chunk.level) ?? []) await page.more!(data.subarray(page.start, page.stop));
    const records = assembler.directories[chunk.level];
    for (const [number, { offset, stored }] of records.entries()) {
      await assembler.addBlock(chunk.level, number, data.subarray(offset, offset + stored));
    }
  }
  return assembler;
}
