MODULE TwoTools
  PERS tooldata tLeft:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  PERS tooldata tRight:=[TRUE,[[97.4,0,263.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  CONST robtarget pShared:=<15|gun|table>;
  CONST robtarget pLeft:=<16|gun|table>;
  PROC Both()
    MoveJ pLeft,v1000,z50,tLeft\WObj:=table;
    MoveL pShared,v100,fine,tLeft\WObj:=table;
    GripLoad load0;
    MoveL pShared,v100,fine,tRight\WObj:=table;
    MoveL RelTool(pShared,0,0,-30),v100,fine,tRight\WObj:=table;
  ENDPROC
ENDMODULE
